"""Agents that plan the stops of a whole flight by heuristics of vehicle routing, and then follow their plan."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.actions import Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import read_observations

MAX_WIDTH = 10_000


class NearestAgent(StatelessAgent):
    """Nearest neighbour with recharging: flies to the nearest parcel from which a pad stays in range, else fills up.

    It plans a flight once, and again from each state that it did not plan. Not thread-safe.

    Args:
        task: The task.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "nearest", "version": 1}
        self._task, self._width = task, 0
        self._planned: dict[int, int] = {}

    def reset(self, seed: int) -> None:
        """Forget all plans."""
        self._planned.clear()

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget all plans."""
        self._planned.clear()

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT at the end of a plan."""
        grounds, drones = read_observations(self._task, grids, telemetry)
        actions = np.zeros(len(grids), np.int64)
        for i, (ground, drone) in enumerate(zip(grounds, drones, strict=True)):
            state = _state(ground, drone)
            if state not in self._planned:
                self._plan(ground, drone)
            actions[i] = self._planned.setdefault(state, int(Action.WAIT))
        return actions

    def _plan(self, ground: npt.NDArray[np.uint8], drone: npt.NDArray[np.int64]) -> None:
        """Store the action of each state of a flight from here on."""
        from drone_env.planning.stops import plan_flight  # Imported lazily: compiling takes seconds.

        for *state, action in plan_flight(self._task, ground, drone, self._width):
            if ground[state[0]] == DELIVERY_CELL:
                ground[state[0]] = DELIVERED_CELL
            self._planned[_state(ground, np.array(state))] = int(action)


class BeamAgent(NearestAgent):
    """Beam search over stops, guided by nearest neighbour with recharging. Its best flight is flown.

    Args:
        task: The task.
        width: Number of partial flights that it keeps after each stop, 1 to 10000; also as text.

    Raises:
        InvalidValueError: if the width is another.
    """

    def __init__(self, task: TaskConfig, width: int | str = 256) -> None:
        super().__init__(task)
        if not str(width).isdecimal() or not 1 <= int(width) <= MAX_WIDTH:
            raise InvalidValueError(f"the width of a beam is 1 to {MAX_WIDTH}, as in beam:16; got {width!r}")
        self._width = int(width)
        self.config = {"agent": "beam", "version": 1, "width": self._width}


def _state(ground: npt.NDArray[np.uint8], drone: npt.NDArray[np.int64]) -> int:
    return hash(ground.tobytes() + drone.tobytes())
