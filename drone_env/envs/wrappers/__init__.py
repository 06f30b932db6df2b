"""The optimum at the end of an episode, and other forms of the observation: planes, one vector, text."""

import string
from collections.abc import Callable
from typing import Any, SupportsFloat, cast

import gymnasium
from gymnasium import spaces

from drone_env.core.cells import SYMBOLS
from drone_env.core.episode import Observation
from drone_env.envs.ansi import TARGET, draw_text
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.forms import planes_space, to_planes, to_vector, vector_space
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


class ObservationForm(gymnasium.ObservationWrapper[Any, int, Observation], gymnasium.utils.RecordConstructorArgs):
    """Base class of the wrappers that show a drone's observations in another form of `envs.forms`."""

    form: Callable[[Observation], Any]
    space_of: Callable[[Any], spaces.Space[Any]]

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self.observation_space = self.space_of(env.observation_space)

    def observation(self, observation: Observation) -> Any:
        """The observation in this form."""
        return self.form(observation)


class OneHotPlanes(ObservationForm):
    """`grid` becomes one-hot planes for convolutional networks: uint8[kinds, H, W]; `telemetry` stays."""

    form, space_of = staticmethod(to_planes), staticmethod(planes_space)


class FlatObservation(ObservationForm):
    """One vector for dense networks: the one-hot planes, row by row, then the telemetry; float32[kinds * H * W + n]."""

    form, space_of = staticmethod(to_vector), staticmethod(vector_space)


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
