"""Episodes over several tasks, whose observations have one shape."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.seeds import SPLITS, check_seed
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.wrappers import StopObservation
from drone_env.errors import InvalidValueError, UnknownNameError

OUTSIDE = N_CELL_KINDS
"""The id of the cells of a grid beyond the map; no one-hot plane marks them."""
Arrays = dict[str, npt.NDArray[Any]]


class MixtureEnv(gymnasium.Env[Arrays, int]):
    """Deliver parcels in one of several tasks per episode.

    Observations are those of `DroneDeliveryEnv`, each array padded to the largest task: the grid by `OUTSIDE`, the
    others by 0. `telemetry` ends with the one-hot number of the task. `info` also contains the id of the `task`.

    Args:
        tasks: The tasks or their names, at least one.
        stops: If True, observations are `forms.StopEntries` instead, and `features` ends with the one-hot number.
        options: `reward_profile` and `render_mode`, as for `DroneDeliveryEnv`, which also raises the other errors.

    Raises:
        InvalidValueError: if there is no task.
    """

    metadata = DroneDeliveryEnv.metadata

    def __init__(self, tasks: Sequence[str | TaskConfig], stops: bool = False, **options: Any) -> None:
        if not tasks:
            raise InvalidValueError("a mixture needs at least one task")
        drones = [DroneDeliveryEnv(task, **options) for task in tasks]
        self.render_mode = drones[0].render_mode
        self._envs: dict[str, Any] = {drone.task.id: StopObservation(drone) if stops else drone for drone in drones}
        self._task = drones[0].task.id
        self._numbers = "features" if stops else "telemetry"
        given: list[Any] = [env.observation_space for env in self._envs.values()]
        self._boxes = {name: self._box(name, [space[name] for space in given]) for name in given[0]}
        self.observation_space = spaces.Dict(self._boxes)  # type: ignore[assignment]
        self.action_space = spaces.Discrete(N_ACTIONS)  # type: ignore[assignment]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
        """Start an episode of a random task, on map `seed` or else a random train map.

        Args:
            seed: In [0, 2^53). It also seeds the choices of the following resets.
            options: `task`, one of the tasks, chooses it.

        Raises:
            UnknownNameError: if the task is not one of this environment.
            InvalidValueError: if the seed is out of range, or there are other options.
        """
        options, known = dict(options or {}), list(self._envs)
        super().reset(seed=None if seed is None else check_seed(seed))
        named = options.pop("task", None)
        task = known[self.np_random.integers(len(known))] if named is None else get_task(named).id
        if task not in known:
            raise UnknownNameError("task of this mixture", task, known)
        if seed is None:
            seed = int(self.np_random.integers(SPLITS["train"].stop))
        observation, info = self._envs[task].reset(seed=seed, options=options)
        self._task = task
        return self._padded(observation), info | {"task": task}

    def step(self, action: int) -> tuple[Arrays, float, bool, bool, dict[str, Any]]:
        """Fly one action; raises as `DroneDeliveryEnv.step`."""
        observation, *ended, info = self._envs[self._task].step(action)
        return self._padded(observation), *ended, info | {"task": self._task}

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """The action mask as bool[5], for `MaskablePPO`."""
        return self._envs[self._task].unwrapped.action_masks()

    def render(self) -> Any:
        """The episode, as `DroneDeliveryEnv.render`."""
        return self._envs[self._task].render()

    def _box(self, name: str, boxes: Sequence[Any]) -> Any:
        """The space of an array that fits those of all tasks."""
        shape = np.max([box.shape for box in boxes], axis=0)
        shape[-1] += len(boxes) * (name == self._numbers)
        high = OUTSIDE if name == "grid" else boxes[0].high.max()
        return spaces.Box(boxes[0].low.min(), high, shape.tolist(), boxes[0].dtype)

    def _padded(self, observation: Arrays) -> Arrays:
        padded: Arrays = {}
        for name, values in observation.items():
            padded[name] = np.full(self._boxes[name].shape, OUTSIDE if name == "grid" else 0, values.dtype)
            padded[name][tuple(map(slice, values.shape))] = values
        padded[self._numbers][list(self._envs).index(self._task) - len(self._envs)] = 1
        return padded
