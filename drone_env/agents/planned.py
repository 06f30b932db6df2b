"""What agents share that plan a whole flight and then fly it."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import episode_of, require_observations

TARGET_TELEMETRY = (3, 4)
"""Where the target stands in the telemetry. Of equally near parcels it is the first by number, which nobody sees."""


class PlannedAgent(ABC):
    """Plans from what it sees and flies the plan; plans again when the world is not what it expected.

    Args:
        task: The task.

    Attributes:
        seeds: int64[N], the maps that are flown; of one that flies alone, its own.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self.seeds = np.zeros(1, np.int64)
        self._plan: list[Action] = []
        self._expected: Episode | None = None
        self._plans: Iterator[npt.NDArray[np.int64]] | None = None

    @abstractmethod
    def plan(self, episode: Episode) -> list[Action]:
        """The actions of a flight from where an episode stands; at their end there may be nothing left but to wait."""

    @abstractmethod
    def plan_all(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of a flight over each of N maps, int64[N, T], WAIT behind its end."""

    def reset(self, seed: int) -> None:
        """Forget the last flight."""
        self.seeds = np.array([seed], np.int64)
        self._plan, self._expected = [], None

    def act(self, observation: Observation) -> int:
        """The next action of the plan; WAIT when it is at its end."""
        if self._expected is None or not _shows(self._expected, observation):
            self._expected = episode_of(self.task, observation)
            self._plan = self.plan(self._expected)
        action = self._plan.pop(0) if self._plan else Action.WAIT
        self._expected.step(action)
        return action

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last flights."""
        self.seeds = seeds
        self._plans = None

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the plans, int64[N]. The first call makes them: no parcel may be delivered yet.

        Raises:
            InvalidValueError: if they are no observations of the task, or not as many as the maps that `reset_batch`
                was told of.
        """
        if len(grids) != len(self.seeds):
            raise InvalidValueError(f"reset_batch was told of {len(self.seeds)} maps, and these are {len(grids)}")
        if self._plans is None:
            require_observations(self.task, grids, telemetry)
            self._plans = iter(self.plan_all(grids, telemetry).T)
        return next(self._plans, np.full(len(grids), Action.WAIT))


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode shows this observation, whichever of the parcels is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )
