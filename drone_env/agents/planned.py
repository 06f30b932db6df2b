"""Agents that plan a whole flight and then fly it, and the optimal one among them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import episode_of, require_observations
from drone_env.planning.optimal import best_actions

TARGET_TELEMETRY = (3, 4)
"""Indices of the target in the telemetry. Ties break by the parcel's number, which no observation contains."""


class PlannedAgent(ABC):
    """Plans from the observation and flies the plan; plans again after an unexpected observation.

    Args:
        task: The task.

    Attributes:
        seeds: int64[N], the seeds of the flights; one for a single flight.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self.seeds = np.zeros(1, np.int64)
        self._plan: list[int] = []
        self._expected: Episode | None = None
        self._plans: Iterator[npt.NDArray[np.int64]] | None = None

    @abstractmethod
    def plan(self, episodes: Sequence[Episode]) -> npt.NDArray[np.int64]:
        """The remaining actions of a flight over each of N episodes, int64[N, T], padded with WAIT."""

    def reset(self, seed: int) -> None:
        """Forget the last flight."""
        self.seeds = np.array([seed], np.int64)
        self._plan, self._expected = [], None

    def act(self, observation: Observation) -> int:
        """The next action of the plan; WAIT when it is at its end."""
        if self._expected is None or not _shows(self._expected, observation):
            self._expected = episode_of(self.task, observation)
            self._plan = self.plan([self._expected])[0].tolist()
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
            InvalidValueError: if they are no observations of the task, or not one for each seed of `reset_batch`.
        """
        if len(grids) != len(self.seeds):
            raise InvalidValueError(f"reset_batch got {len(self.seeds)} seeds, act_batch got {len(grids)} observations")
        if self._plans is None:
            require_observations(self.task, grids, telemetry)
            obs = zip(grids, telemetry, strict=True)
            episodes = [episode_of(self.task, {"grid": grid, "telemetry": values}) for grid, values in obs]
            self._plans = iter(self.plan(episodes).T)
        return next(self._plans, np.full(len(grids), Action.WAIT))


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode has this observation, whichever parcel is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )


class OptimalAgent(PlannedAgent):
    """Plans a best flight and flies it.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        super().__init__(task)
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 2}

    def plan(self, episodes: Sequence[Episode]) -> npt.NDArray[np.int64]:
        """The remaining actions of a best flight over each episode, int64[N, max_steps]."""
        plans = np.full((len(episodes), self.task.max_steps), Action.WAIT, np.int64)
        for plan, episode in zip(plans, episodes, strict=True):
            actions = best_actions(episode)
            plan[: len(actions)] = actions
        return plans
