"""Wrappers: the optimum at the end of an episode, and observations in other forms."""

from typing import Any, SupportsFloat, cast

import gymnasium
from gymnasium.wrappers import TransformObservation

from drone_env.core.episode import Observation
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.forms import StopEntries, planes_space, to_planes, to_vector, vector_space
from drone_env.planning.optimal import Solution, best_of

Env = gymnasium.Env[Observation, int]


class WithOptimum(gymnasium.Wrapper[Observation, int, Observation, int], gymnasium.utils.RecordConstructorArgs):
    """Solve the map of each episode. `gymnasium.make` applies this wrapper to every task.

    Every `info` then also contains `optimal_score`, `optimal_steps` and `regret` (optimal minus own score, provisional
    until the end), unless the map is too large to be solved.
    """

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._optimum: tuple[int, Solution | None] = (-1, None)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode, and solve its map."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._with_optimum(info)

    def step(self, action: int) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Fly one action."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, self._with_optimum(info)

    def _with_optimum(self, info: dict[str, Any]) -> dict[str, Any]:
        seed = info["seed"]
        if self._optimum[0] != seed:
            self._optimum = seed, best_of(cast(DroneDeliveryEnv, self.unwrapped).task, seed)
        best = self._optimum[1]
        if best is None:
            return info
        return info | {"optimal_score": best.score, "optimal_steps": best.steps, "regret": best.score - info["score"]}


def make(**options: Any) -> WithOptimum:
    """The entry point of `gymnasium.make`; the options are those of `DroneDeliveryEnv`."""
    return WithOptimum(DroneDeliveryEnv(**options))


make.metadata = DroneDeliveryEnv.metadata  # type: ignore[attr-defined]  # Gymnasium reads the render modes here


class OneHotPlanes(TransformObservation[Any, int, Observation]):
    """Replace `grid` by one-hot planes for convolutional networks: uint8[kinds, H, W]. Keep `telemetry`."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env, to_planes, planes_space(env.observation_space))


class FlatObservation(TransformObservation[Any, int, Observation]):
    """One vector for dense networks: the one-hot planes, row by row, then the telemetry; float32[kinds * H * W + n]."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env, to_vector, vector_space(env.observation_space))


class StopObservation(TransformObservation[Any, int, Observation]):
    """The stops as the drone sees them, for an embedding table: `forms.StopEntries`."""

    def __init__(self, env: Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        form = StopEntries(cast(DroneDeliveryEnv, env.unwrapped).task)
        super().__init__(env, form, form.space)
