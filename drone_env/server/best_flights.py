"""Jobs of worker processes: a best flight over a map, and that of the preferred network."""

from contextlib import suppress

from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, TooLargeError
from drone_env.models import Position, Score
from drone_env.planning.optimal import Solution, solve_episode
from drone_env.server.frames import plan
from drone_env.server.jobs import job_context
from drone_env.server.pilots import PLANNER_PILOTS


def planner_of(task: TaskConfig) -> str | None:
    """The pilot of the preferred network that flies a task, None without one."""
    return next((pilot for pilot in PLANNER_PILOTS if job_context().networks.flies(pilot, task)), None)


def network_flight(task: TaskConfig, seed: int) -> tuple[str, Score] | tuple[None, None]:
    """The pilot of the preferred network and its score over a map, if there is one: a job of a worker process."""
    pilot, episode = planner_of(task), Episode(task, seed=seed)
    with suppress(CheckpointError, TooLargeError):
        if pilot is not None:
            plan(episode, pilot)
            return pilot, episode.score
    return None, None


def best_flight(task: TaskConfig, seed: int) -> tuple[Solution, list[Position]]:
    """A best flight over a map, and [x, y] of the drone from the start: a job of a worker process.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    start = Episode(task, seed=seed)
    # If every step costs the same, the shortest tour needs no solver.
    best = solve_episode(start, None if task.uniform else job_context().solver_of(task, seed))
    return best, [start.position, *((step.x, step.y) for step in start.copy().fly(best.actions).path)]
