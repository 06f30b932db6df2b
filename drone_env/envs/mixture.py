"""Episodes over several tasks, whose observations have one shape."""

from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.seeds import SPLITS, check_seed
from drone_env.core.tasks import TaskConfig
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.wrappers import StopObservation
from drone_env.errors import InvalidValueError, UnknownNameError

OUTSIDE = N_CELL_KINDS
"""The id of the cells of a grid beyond the map; no one-hot plane marks them."""


class MixtureEnv(gymnasium.Env[dict[str, npt.NDArray[Any]], int]):
    """Deliver parcels in one of several tasks per episode.

    Observations are those of `DroneDeliveryEnv`, each array padded to the largest task: the grid by `OUTSIDE`, the
    others by 0. `telemetry` ends with the one-hot number of the task. `info` also contains the id of the `task`.

    Args:
        tasks: The tasks or their names.
        stops: If True, observations are `forms.StopEntries` instead, and `features` ends with the one-hot number.
        options: `reward_profile` and `render_mode`, as for `DroneDeliveryEnv`.

    Raises:
        UnknownNameError: if a task or the profile does not exist.
        InvalidValueError: if there is no task, or one twice, or the render mode does not exist.
    """

    metadata = DroneDeliveryEnv.metadata

    def __init__(self, tasks: Sequence[str | TaskConfig], stops: bool = False, **options: Any) -> None:
        self.render_mode = options.get("render_mode")
        self.drones = [DroneDeliveryEnv(task, **options) for task in tasks]
        if not 0 < len({drone.task.id for drone in self.drones}) == len(tasks):
            raise InvalidValueError("a mixture needs one or more tasks, all of them different")
        self._envs: list[Any] = [StopObservation(drone) for drone in self.drones] if stops else [*self.drones]
        self._numbers = "features" if stops else "telemetry"
        self._index = 0
        given: list[spaces.Dict] = [env.observation_space for env in self._envs]
        self._boxes = {name: self._box(name, [cast(spaces.Box, space[name]) for space in given]) for name in given[0]}
        self.observation_space = spaces.Dict(self._boxes)  # type: ignore[assignment]
        self.action_space = spaces.Discrete(N_ACTIONS)  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
        """Start an episode of a random task, on map `seed` or else a random train map.

        Args:
            seed: In [0, 2^53). It also seeds the choices of the following resets.
            options: `task`, one of the tasks, chooses it.

        Raises:
            UnknownNameError: if the task is not one of this environment.
            InvalidValueError: if the seed is out of range, or there are other options.
        """
        options = dict(options or {})
        super().reset(seed=None if seed is None else check_seed(seed))
        tasks, name = [drone.task for drone in self.drones], options.pop("task", None)
        chosen = [i for i, task in enumerate(tasks) if name in (None, task.id, task.short_name)]
        if not chosen:
            raise UnknownNameError("task of this mixture", name, [task.short_name for task in tasks])
        index = int(self.np_random.choice(chosen))
        if seed is None:
            seed = int(self.np_random.integers(SPLITS["train"].stop))
        observation, info = self._envs[index].reset(seed=seed, options=options)
        self._index = index
        return self._padded(observation), info | {"task": tasks[index].id}

    def step(self, action: int) -> tuple[dict[str, npt.NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Fly one action; raises as `DroneDeliveryEnv.step`."""
        observation, reward, terminated, truncated, info = self._envs[self._index].step(action)
        info["task"] = self.drones[self._index].task.id
        return self._padded(observation), reward, terminated, truncated, info

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """The action mask as bool[5], for `MaskablePPO`."""
        return self.drones[self._index].action_masks()

    def render(self) -> Any:
        """The episode, as `DroneDeliveryEnv.render`."""
        return self.drones[self._index].render()

    def _box(self, name: str, boxes: Sequence[spaces.Box]) -> spaces.Box:
        """The space of an array that fits those of all tasks."""
        shape = np.max([box.shape for box in boxes], axis=0)
        shape[-1] += len(boxes) * (name == self._numbers)
        high = OUTSIDE if name == "grid" else boxes[0].high.flat[0]
        return spaces.Box(boxes[0].low.flat[0], high, tuple(shape.tolist()), boxes[0].dtype.type)  # type: ignore[arg-type]

    def _padded(self, observation: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
        padded: dict[str, npt.NDArray[Any]] = {}
        for name, values in observation.items():
            box: Any = self._boxes[name]
            padded[name] = np.full(box.shape, OUTSIDE if name == "grid" else 0, box.dtype)
            padded[name][tuple(map(slice, values.shape))] = values
        padded[self._numbers][self._index - len(self.drones)] = 1
        return padded
