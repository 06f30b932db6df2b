"""The wrappers of observations for many drones at once; they have the names of those for one drone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space, iterate

from drone_env.envs.forms import planes_space, to_planes, to_vector, vector_space

Array = npt.NDArray[Any]
Observations = dict[str, Array]


# Gymnasium's older versions have no type parameters here.
class VectorForm(VectorWrapper):  # pyright: ignore[reportMissingTypeArgument]
    """Shows the observations of many drones in another form, those that end episodes too.

    Args:
        env: The environment, native or vectorised by Gymnasium, in any autoreset mode.
    """

    observations: Callable[[Observations], Any]
    space_of: Callable[[Any], spaces.Space[Any]]

    def __init__(self, env: VectorEnv[Observations, Array, Array]) -> None:
        super().__init__(env)
        self.single_observation_space = self.space_of(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When an episode that ended is followed by the next one."""
        return self.metadata["autoreset_mode"]

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, as the wrapped environments do."""
        observations, info = self.env.reset(seed=seed, options=options)
        return self.observations(observations), info

    def step(self, actions: Array) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """Fly one action in each episode, as the wrapped environments do."""
        observations, rewards, terminations, truncations, info = self.env.step(actions)
        if "final_obs" in info:
            info = {**info, "final_obs": self._finals(info["final_obs"], np.flatnonzero(info["_final_obs"]))}
        return self.observations(observations), rewards, terminations, truncations, info

    def _finals(self, finals: Array, ended: npt.NDArray[np.int64]) -> Array:
        """The last observations of the episodes `ended`, each an object of its own, as Gymnasium hands them out."""
        last = finals[ended]
        shown = self.observations({name: np.stack([one[name] for one in last]) for name in last[0]})
        formed = np.full(len(finals), None, object)
        for i, one in zip(ended, iterate(self.observation_space, shown), strict=True):
            formed[i] = one
        return formed


class OneHotPlanes(VectorForm):
    """`grid` becomes one-hot planes for convolutional networks: uint8[N, kinds, H, W]; `telemetry` stays."""

    observations, space_of = staticmethod(to_planes), staticmethod(planes_space)


class FlatObservation(VectorForm):
    """One vector a drone for dense networks: the one-hot planes, then the telemetry; float32[N, kinds * H * W + n]."""

    observations, space_of = staticmethod(to_vector), staticmethod(vector_space)
