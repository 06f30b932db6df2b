"""The optimum at the end of an episode, and other forms of the observation: planes, one vector, text."""

import string
from typing import Any, SupportsFloat, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from drone_env.core.cells import SYMBOLS
from drone_env.core.episode import Observation
from drone_env.envs.ansi import TARGET, draw_text
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.forms import planes_space, to_planes, to_vector, vector_space
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import best_of

Env = gymnasium.Env[Observation, int]


class WithOptimum(gymnasium.Wrapper[Observation, int, Observation, int], gymnasium.utils.RecordConstructorArgs):
    """Solves the map when its episode ends. `gymnasium.make` applies it to every environment of this package.

    The last `info` then also holds `optimal_score`, `optimal_steps` and `regret` (optimal minus own score), which are
    None on a task that no planner solves exactly.
    """

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def step(self, action: int) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Fly one action, and solve the map if it ends the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated:
            optimum = best_of(cast(DroneDeliveryEnv, self.unwrapped).task, info["seed"])
            info["optimal_score"] = optimum and optimum.score
            info["optimal_steps"] = optimum and optimum.steps
            info["regret"] = optimum and optimum.score - info["score"]
        return observation, reward, terminated, truncated, info


def make(**options: Any) -> WithOptimum:
    """What `gymnasium.make` makes of an id of this package; the options are those of `DroneDeliveryEnv`."""
    return WithOptimum(DroneDeliveryEnv(**options))


make.metadata = DroneDeliveryEnv.metadata  # type: ignore[attr-defined]  # by which Gymnasium knows the render modes


class OneHotPlanes(gymnasium.ObservationWrapper[Any, int, Observation], gymnasium.utils.RecordConstructorArgs):
    """`grid` becomes one-hot planes for convolutional networks: uint8[kinds, H, W]; `telemetry` stays."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(_single(env, type(self)))
        self.observation_space = planes_space(env.observation_space)

    def observation(self, observation: Observation) -> dict[str, npt.NDArray[Any]]:
        """The observation with planes for a grid."""
        return to_planes(observation)


class FlatObservation(gymnasium.ObservationWrapper[Any, int, Observation], gymnasium.utils.RecordConstructorArgs):
    """One vector for dense networks: the one-hot planes, row by row, then the telemetry; float32[kinds * H * W + n]."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(_single(env, type(self)))
        self.observation_space = vector_space(env.observation_space)

    def observation(self, observation: Observation) -> npt.NDArray[np.float32]:
        """The observation as one vector."""
        return to_vector(observation)


class TextObservation(gymnasium.ObservationWrapper[str, int, Observation], gymnasium.utils.RecordConstructorArgs):
    """The episode as text, for language models and people: the map in emoji with a status line."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        height, width = cast(tuple[int, int], cast(spaces.Dict, env.observation_space)["grid"].shape)
        charset = set(string.printable) | {c for symbol in (*SYMBOLS.values(), TARGET) for c in symbol}
        self.observation_space = spaces.Text(
            max_length=4 * (width + 2) * (height + 2) + 500, charset="".join(sorted(charset))
        )

    def observation(self, observation: Observation) -> str:
        """The episode as text."""
        return draw_text(cast(DroneDeliveryEnv, self.unwrapped).episode)


def _single(env: Env, wrapper: type[Any]) -> Env:
    """The environment, which is to be a single one."""
    if isinstance(env, gymnasium.vector.VectorEnv):
        name = wrapper.__name__
        raise InvalidValueError(f"for many drones take drone_env.envs.wrappers.vector.{name}; this {name} is for one")
    return env
