"""The observation wrappers for vector environments, in every autoreset mode."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from drone_env.envs.forms import StopEntries, planes_space, to_planes, to_vector, vector_space
from drone_env.envs.vector import DroneDeliveryVectorEnv

Array = npt.NDArray[Any]
Observations = dict[str, Array]
Env = VectorEnv[Observations, Array, Array]


# Older Gymnasium versions have no type parameters here.
class FormWrapper(VectorWrapper):  # pyright: ignore[reportMissingTypeArgument]
    """Replace the observations by another form, those in `final_obs` too.

    Gymnasium's own base class for this refuses `SAME_STEP` mode.

    Args:
        env: The environment.
        space: The space of one drone's observations.
        to_form: The function that makes them from plain ones.
    """

    def __init__(self, env: Env, space: spaces.Space[Any], to_form: Callable[[Any], Any]) -> None:
        super().__init__(env)
        self.autoreset_mode = env.metadata["autoreset_mode"]  # TorchRL reads it; Gymnasium's wrappers do not forward it
        self._to_form = to_form
        self.single_observation_space = space
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes."""
        observations, info = self.env.reset(seed=seed, options=options)
        return self._to_form(observations), info

    def step(self, actions: Array) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """Fly one action in each episode."""
        observations, rewards, terminated, truncated, info = self.env.step(actions)
        if "final_obs" in info:
            for i in np.flatnonzero(info["_final_obs"]):
                info["final_obs"][i] = self._to_form(info["final_obs"][i])
        return self._to_form(observations), rewards, terminated, truncated, info


class OneHotPlanes(FormWrapper):
    """Replace `grid` by one-hot planes for convolutional networks: uint8[N, kinds, H, W]. Keep `telemetry`."""

    def __init__(self, env: Env) -> None:
        super().__init__(env, planes_space(env.single_observation_space), to_planes)


class FlatObservation(FormWrapper):
    """One vector per drone for dense networks: the planes, then the telemetry; float32[N, kinds * H * W + n]."""

    def __init__(self, env: Env) -> None:
        super().__init__(env, vector_space(env.single_observation_space), to_vector)


class StopObservation(FormWrapper):
    """The stops as the drones see them, for an embedding table: `forms.StopEntries`."""

    def __init__(self, env: Env) -> None:
        form = StopEntries(cast(DroneDeliveryVectorEnv, env.unwrapped).task)
        super().__init__(env, form.space, form)
