"""The agent that flies a best flight, from nothing but what it observes."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.agents.planned import PlannedAgent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import episode_of
from drone_env.planning.optimal import best_actions


class OptimalAgent(PlannedAgent):
    """Plans a best flight and flies it.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        super().__init__(task)
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 2}

    def plan(self, episode: Episode) -> list[Action]:
        """The actions of a best flight."""
        return best_actions(episode)

    def plan_all(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of a best flight over each map, int64[N, T]."""
        plans = np.full((len(grids), self.task.max_steps), Action.WAIT, np.int64)
        for plan, grid, values in zip(plans, grids, telemetry, strict=True):
            actions = best_actions(episode_of(self.task, {"grid": grid, "telemetry": values}))
            plan[: len(actions)] = actions
        return plans
