"""An episode as the page shows it: its opening, then one frame per step."""

from typing import cast

from pydantic import Field

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Event
from drone_env.core.episode import Episode, Observation
from drone_env.core.rules import EFFICIENCY_WEIGHTS
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
from drone_env.server.pilots import HUMAN, PILOTS, Credit


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
