"""The agent that tries whole plans of the tour network in the simulator and flies the best."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.planned import PlannedAgent
from drone_env.agents.tournet import tour_network
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import episode_of


class TournetSearchAgent(PlannedAgent):
    """Flies the best of K plans: the one that `tournet` prefers, and others that are drawn from its network.

    A plan flies each way to its end before it chooses the next, and `tournet` chooses anew at every step: on some maps
    (21 of 1,000 of skyline_hard with 8 plans) none of them is as good as what `tournet` flies. What is drawn depends on
    the seed of the map alone.
    Not to be shared between threads.

    Args:
        task: The task.
        network: The file of an exported tour network; None for the shipped one.
        plans: K, at least 1.

    Raises:
        InvalidValueError: if there is to be no plan.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        TooLargeError: if what there is to see on a map of the task would take too much memory.
        UnsupportedTaskError: if no network is shipped.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None, plans: int = 8) -> None:
        super().__init__(task)
        if plans < 1:
            raise InvalidValueError(f"plans must be at least 1, got {plans}")
        from drone_env.agents.tour_plans import TEMPERATURES, TourPlanner  # compiles

        flown_by = tour_network(network)
        self._planner = TourPlanner(task, flown_by, plans)
        self.config: Mapping[str, object] = {
            "agent": "tournet-search",
            "version": 1,
            "plans": plans,
            "temperatures": list(TEMPERATURES),
            "network": flown_by.digest,
        }

    def plan(self, episode: Episode) -> list[Action]:
        """The actions of the best plan from where an episode stands."""
        return [Action(action) for action in self._best([episode])[0].tolist()]

    def plan_all(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of the best plan over each map, int64[N, max_steps]."""
        seen = zip(grids, telemetry, strict=True)
        return self._best([episode_of(self.task, {"grid": grid, "telemetry": values}) for grid, values in seen])

    def _best(self, episodes: list[Episode]) -> npt.NDArray[np.int64]:
        """The actions of the best plans from where episodes stand, from their next step on."""
        snapshots = [episode.get_state() for episode in episodes]
        grids = np.stack([np.frombuffer(snapshot.grid, np.uint8) for snapshot in snapshots])
        states = np.stack([np.frombuffer(snapshot.numbers, np.uint16) for snapshot in snapshots])
        plans = np.full((len(episodes), self.task.max_steps), Action.WAIT, np.int64)
        for plan, actions, episode in zip(plans, self._planner.best(grids, states, self.seeds), episodes, strict=True):
            plan[: len(actions) - episode.steps] = actions[episode.steps :]
        return plans
