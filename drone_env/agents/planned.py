"""Agents that plan a whole flight and follow it: the best one, or one by heuristics of vehicle routing."""

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.actions import Action, Event
from drone_env.core.cells import DELIVERED_CELL
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import episode_of, read_observations
from drone_env.planning.optimal import best_actions

MAX_WIDTH = 10_000
"""A wider beam would compare each partial flight with more than this many others."""


class PlannedAgent(StatelessAgent):
    """Follows a planned flight, and plans again from each state that it did not plan. Not thread-safe.

    Plans are found by state, not by row. So the rows of a batch may be fewer at each step, as for a stateless agent.

    Args:
        task: The task.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self._planned: dict[int, int] = {}

    def plan(self, episode: Episode) -> Iterable[int]:
        """The actions of a flight from an episode, which is not changed. Only waiting remains after them."""
        raise NotImplementedError

    def reset(self, seed: int) -> None:
        """Forget all plans."""
        self._planned.clear()

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget all plans."""
        self._planned.clear()

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT at the end of a plan."""
        grounds, drones = read_observations(self.task, grids, telemetry)
        actions = np.zeros(len(grids), np.int64)
        for i, (ground, drone) in enumerate(zip(grounds, drones, strict=True)):
            state = _state(ground, *drone.tolist())
            if state not in self._planned:
                self._fly(episode_of(self.task, {"grid": grids[i], "telemetry": telemetry[i]}), ground)
            actions[i] = self._planned[state]
        return actions

    def _fly(self, episode: Episode, ground: npt.NDArray[np.uint8]) -> None:
        """Plan a flight from an episode and store the action in each of its states."""
        actions = iter(self.plan(episode))
        while True:
            action = next(actions, Action.WAIT)
            left = self.task.max_steps - episode.steps
            self._planned[_state(ground, episode.cell, episode.battery_units, left)] = int(action)
            if episode.ended:
                break
            episode.step(action)
            if episode.event is Event.DELIVERY:
                ground[episode.cell] = DELIVERED_CELL


class OptimalAgent(PlannedAgent):
    """Plans a best flight from the observation and flies it; plans again after an unexpected observation.

    Args:
        task: The task.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    config: Mapping[str, object] = {"agent": "optimal", "version": 2}

    def plan(self, episode: Episode) -> Iterable[int]:
        """Plan a best flight."""
        return best_actions(episode)


class NearestAgent(PlannedAgent):
    """Nearest neighbour with recharging: flies to the nearest parcel from which a pad stays in range, else fills up.

    Args:
        task: The task.
    """

    config: Mapping[str, object] = {"agent": "nearest", "version": 1}
    width = 0

    def plan(self, episode: Episode) -> Iterable[int]:
        """Plan the stops of a flight."""
        from drone_env.planning.stops import planned_actions  # Imported lazily: compiling takes seconds.

        return planned_actions(episode, self.width)


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
        self.width = int(width)
        self.config = {"agent": "beam", "version": 1, "width": self.width}


def _state(ground: npt.NDArray[np.uint8], cell: int, units: int, left: int) -> int:
    """A key of a state. The bytes of thousands of flights over a large map would take gigabytes."""
    return hash((ground.tobytes(), cell, units, left))
