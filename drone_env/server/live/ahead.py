"""What is worked out for a flight ahead of time: jobs of a worker process."""

from collections.abc import Sequence
from typing import NamedTuple

from pydantic_core import to_json

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, rollout
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.models import Direction
from drone_env.results.record import fly_directions
from drone_env.server.frames import Frame, frame_of, shows_values
from drone_env.server.jobs import bench
from drone_env.server.pilots import Credit, agent_of


class MapOf(NamedTuple):
    """The map of a flight, and what its steps pay."""

    task: TaskConfig
    seed: int
    reward_profile: str

    @classmethod
    def of(cls, episode: Episode) -> "MapOf":
        """The map of an episode."""
        return cls(episode.task, episode.seed, episode.reward_profile.id)

    def start(self) -> Episode:
        """The flight at its start."""
        return Episode(self.task, self.reward_profile, self.seed)


def plan(map_of: MapOf, pilot: str, actions: Sequence[int], first: int, check: bool = False) -> list[int]:
    """All actions of a pilot's flight to its end.

    Args:
        map_of: The map.
        pilot: Who flies: an agent.
        actions: What has been flown already.
        first: How many of these others flew. From there on the pilot is asked at every step, as when it flew them.
        check: Whether to refuse actions of its own that it would not fly.

    Raises:
        EpisodeError: if `check` finds such an action.
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if its file holds none that fits.
        TooLargeError: if the map is too large for the pilot.
    """
    episode, agent = map_of.start(), agent_of(pilot, map_of.task, bench().networks)
    assert agent is not None
    agent.reset(map_of.seed)
    for step, action in enumerate(actions, 1):
        if step > first:
            chosen = int(agent.act(episode.observation()))
            if check and chosen != action:
                raise EpisodeError(
                    f"step {step} of the fork is said to be flown by {pilot}, which flies {Action(chosen).name} there"
                )
        episode.step(action)
    return [int(action) for action in rollout(episode, agent.act).actions]


def values_along(map_of: MapOf, actions: Sequence[int], first: int) -> tuple[list[float], list[float] | None]:
    """What can still be reached along a flight.

    Args:
        map_of: The map.
        actions: What was flown.
        first: The frame to begin with; 0 is the start.

    Returns:
        The best score that can still be reached at each frame from `first` on; and after each action that the last one
        leads to, or None if the flight has ended there.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    solver, flight = bench().solver_of(map_of.task, map_of.seed), map_of.start()
    flight.fly(actions[:first])
    values = [solver.value(flight)]
    for action in actions[first:]:
        flight.step(action)
        values.append(solver.value(flight))
    return values, None if flight.ended else solver.q_values(flight).tolist()


def frames_json(map_of: MapOf, by: str, directions: Sequence[Direction]) -> str:
    """The frames of a flight so far, frame 0 among them, as a JSON array.

    Args:
        map_of: The map.
        by: Who flies, as sessions have it.
        directions: What was flown.

    Raises:
        InvalidValueError: if there are actions after the end.
    """
    episode, credit = map_of.start(), Credit.parse(by)
    network = bench().networks.beside(credit.pilot, map_of.task)

    def frame() -> Frame:
        return frame_of(episode, episode.observation(), network if shows_values(credit, episode) else None)

    return to_json([frame(), *(frame() for _ in fly_directions(episode, directions))]).decode()
