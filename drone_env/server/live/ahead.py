"""What is worked out for a flight ahead of time: jobs of a worker process."""

from collections.abc import Sequence
from typing import NamedTuple

from pydantic_core import to_json

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rollout import rollout
from drone_env.core.tasks import TaskConfig
from drone_env.episodes.record import fly_directions
from drone_env.errors import EpisodeError
from drone_env.models import Direction
from drone_env.server.frames import Frame, frame_of
from drone_env.server.jobs import bench
from drone_env.server.pilots import HUMAN, Credit, agent_of


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


def values_along(map_of: MapOf, actions: Sequence[int]) -> list[float]:
    """The best score that can still be reached at the start of a flight and after each of its actions.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    solver, flight = bench().solver_of(map_of.task, map_of.seed), map_of.start()
    values = [solver.value(flight)]
    for action in actions:
        flight.step(action)
        values.append(solver.value(flight))
    return values


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


def shows_values(credit: Credit, episode: Episode) -> bool:
    """Whether values are shown: they are hidden from a person in flight who has not asked for them."""
    return credit.pilot != HUMAN or credit.values or episode.ended
