"""An episode as the page shows it: its opening, then one frame per step."""

from collections.abc import Sequence
from typing import NamedTuple, cast

from pydantic import Field
from pydantic_core import to_json

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action, Event
from drone_env.core.episode import Episode, Observation, rollout
from drone_env.core.rules import EFFICIENCY_WEIGHTS
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.models import (
    DIRECTIONS,
    NAMES,
    Count,
    Direction,
    EventName,
    GroundName,
    Message,
    OutcomeName,
    Position,
    Score,
)
from drone_env.results.record import fly_directions
from drone_env.server.jobs import bench
from drone_env.server.pilots import HUMAN, PILOTS, Credit, agent_of


class Opening(Message):
    """Who flies which map, and how it looks at the start."""

    session: str | None = Field(description="The session that flies it; null for a flight of the past.")
    pilot: str = Field(description="Id of the pilot that flies; of a record that names none, its agent.")
    by: str = Field(
        description="Who flies or flew, in full: the pilot; ` with values`, ` with undo` or ` with values and undo` "
        "where a person asked for that; ` from step N of ` and who flew up to there where it is a fork."
    )
    forked_at: Count | None = Field(description="How many of the steps others flew; null where it is no fork.")
    task: str = Field(description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    short_name: str = Field(description="Short name of the task.")
    seed: Count = Field(description="Number of the map.")
    reward_profile: str = Field(description="Id of the reward profile.")
    width: int
    height: int
    max_steps: int
    battery_capacity: int
    deliveries_total: int
    cells: list[list[int]] = Field(description="Kinds of the cells at the start, cells[y][x], without the drone.")
    parcels: list[Position] = Field(description="[x, y] of each parcel.")
    start: Position = Field(description="[x, y] where the drone starts.")

    @classmethod
    def of(cls, episode: Episode, by: str, session: str | None = None) -> "Opening":
        """The opening of an episode that has been reset and not stepped; `by` as sessions and records have it."""
        task, credit = episode.task, Credit.parse(by)
        x, y = episode.position
        cells = episode.grid().tolist()
        cells[y][x] = episode.under
        return cls(
            session=session,
            pilot=credit.pilot if credit.pilot in PILOTS else by,
            by=by,
            forked_at=credit.forked_at,
            task=task.id,
            task_version=task.version,
            short_name=task.short_name,
            seed=episode.seed,
            reward_profile=episode.reward_profile.id,
            width=task.width,
            height=task.height,
            max_steps=task.max_steps,
            battery_capacity=task.battery_capacity,
            deliveries_total=task.deliveries,
            cells=cells,
            parcels=[(px, py) for px, py, _ in episode.parcels],
            start=(x, y),
        )


class EfficiencyPart(Message):
    """One part of the efficiency."""

    name: str
    weight: int = Field(description="In percent; all parts have 100 together.")
    share: float = Field(ge=0, le=1, description="How much of it there is.")


class Frame(Message):
    """How a flight stands after a step; frame 0 is the reset."""

    step: Count = Field(description="Steps flown.")
    action: Direction | None = Field(description="What was flown to come here; null in frame 0.")
    x: Count
    y: Count
    cell_below: GroundName = Field(description="Kind of the cell below the drone; `pad` charges.")
    event: EventName | None = Field(description="What happened in the step; null in frame 0.")
    reward: float = Field(description="What the step paid.")
    reward_total: float
    battery: float = Field(ge=0, le=1, description="Share of the battery left.")
    battery_units: Count
    deliveries_done: Count
    delivered: list[Position] = Field(description="[x, y] of the parcels delivered so far.")
    target: Position | None = Field(description="[x, y] of the current target.")
    distance: int | None = Field(description="Manhattan distance to it in cells.")
    telemetry: list[float] = Field(description="The numbers that the network is given beside the grid.")
    score: Score = Field(description="The graded score as the flight stands; provisional until `done`.")
    efficiency: float = Field(ge=0, le=100, description="The weighted sum of its parts; not the score.")
    efficiency_parts: list[EfficiencyPart]
    message: str = Field(description="What happened, in words.")
    done: bool
    outcome: OutcomeName
    q_values: dict[Direction, float] | None = Field(
        description="The network's value of each action from here: of the one that flies, else of the one that "
        "/predict asks; null where there is none that can be read, at the end, and for a person who has not asked."
    )
    value: Score | None = Field(
        default=None, description="The best score that can still be reached; null if not shown."
    )
    regret: float | None = Field(default=None, ge=0, description="Optimum of the map - value.")


class ShownEpisode(Message):
    """An episode, frame by frame."""

    opening: Opening
    frames: list[Frame] = Field(description="Frame 0 is the reset; then one per step.")


def frame_of(
    episode: Episode,
    observation: Observation,
    network: PathQNetAgent | None = None,
    value: float | None = None,
    optimum: float | None = None,
) -> Frame:
    """The frame of an episode as it stands.

    Args:
        episode: The episode.
        observation: What an agent sees of it now.
        network: The network to ask for the value of each action, None for none.
        value: The best score that can still be reached, None while it is unknown or kept back.
        optimum: The optimum of the map, where `value` is given.
    """
    x, y = episode.position
    last = episode.last_step
    asked = None if network is None or episode.ended else network.q_values(observation)
    return Frame(
        step=episode.steps,
        action=None if last is None else last.action.name,
        x=x,
        y=y,
        cell_below=cast(GroundName, NAMES[episode.under]),
        event=None if episode.event is Event.NONE else cast(EventName, episode.event.name.lower()),
        reward=episode.reward_last,
        reward_total=episode.reward_total,
        battery=episode.battery,
        battery_units=episode.battery_units,
        deliveries_done=episode.deliveries_done,
        delivered=[(px, py) for px, py, delivered in episode.parcels if delivered],
        target=episode.target,
        distance=episode.distance_to_target,
        telemetry=observation["telemetry"].tolist(),
        score=episode.score,
        efficiency=episode.efficiency,
        efficiency_parts=[
            EfficiencyPart(name=name, weight=weight, share=share)
            for (name, weight), share in zip(EFFICIENCY_WEIGHTS.items(), episode.efficiency_shares, strict=True)
        ],
        message=episode.message,
        done=episode.ended,
        outcome=cast(OutcomeName, episode.outcome.name.lower()),
        q_values=None if asked is None else dict(zip(DIRECTIONS, asked.tolist(), strict=True)),
        value=value,
        regret=None if value is None or optimum is None else optimum - value,
    )


def shows_values(credit: Credit, episode: Episode) -> bool:
    """Whether values are shown: they are hidden from a person in flight who has not asked for them."""
    return credit.pilot != HUMAN or credit.values or episode.ended


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


def values_along(map_of: MapOf, actions: Sequence[int], first: int) -> list[float]:
    """What can still be reached along a flight.

    Args:
        map_of: The map.
        actions: What was flown.
        first: The frame to begin with; 0 is the start.

    Returns:
        The best score that can still be reached at each frame from `first` on.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    solver, flight = bench().solver_of(map_of.task, map_of.seed), map_of.start()
    flight.fly(actions[:first])
    values = [solver.value(flight)]
    for action in actions[first:]:
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
