"""An episode as the page shows it: a header, then one frame per step. The jobs of the page's flights, for workers."""

from collections.abc import Sequence
from typing import cast

from pydantic import Field
from pydantic_core import to_json

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Event
from drone_env.core.episode import Episode, rollout
from drone_env.core.rules import EFFICIENCY_WEIGHTS
from drone_env.core.tasks import TaskConfig
from drone_env.flights.provenance import HUMAN, Provenance
from drone_env.models import (
    DIRECTIONS,
    Count,
    Direction,
    EventName,
    GroundName,
    OutcomeName,
    Position,
    Score,
    StrictModel,
    observation_numbers,
)
from drone_env.server.jobs import job_networks, solver_of_map
from drone_env.server.networks import Networks


class FlightHeader(Provenance):
    """The provenance, the map and its state at the start."""

    session: str | None = Field(description="The session that flies it; null for a finished flight.")
    task: str = Field(description="Id of the task.")
    seed: Count = Field(description="Number of the map.")
    reward_profile: str = Field(description="Id of the reward profile.")
    cells: list[list[int]] = Field(description="Kinds of the cells at the start, cells[y][x], without the drone.")
    parcels: list[Position] = Field(description="[x, y] of each parcel.")

    @classmethod
    def at_start(cls, episode: Episode, provenance: Provenance, session: str | None = None) -> "FlightHeader":
        """The header of an episode at its start."""
        x, y = episode.position
        cells = episode.grid().tolist()
        cells[y][x] = episode.under
        return cls(
            session=session,
            **dict(provenance),
            task=episode.task.id,
            seed=episode.seed,
            reward_profile=episode.reward_profile.id,
            cells=cells,
            parcels=[(px, py) for px, py, _ in episode.parcels],
        )


class EfficiencyPart(StrictModel):
    """One part of the efficiency and of the score."""

    name: str
    weight: int = Field(description="Weight in percent; the weights add up to 100.")
    share: float = Field(ge=0, le=1, description="Value of this part.")
    score: float = Field(description="What this part adds to the score.")


class Frame(StrictModel):
    """The state of a flight after a step; frame 0 is the reset."""

    step: Count = Field(description="Steps flown.")
    action: Direction | None = Field(description="The action of this step; null in frame 0.")
    x: Count
    y: Count
    cell_below: GroundName = Field(description="Kind of the cell below the drone; a `pad` charges the battery.")
    event: EventName | None = Field(description="The event of this step; null in frame 0.")
    reward: float = Field(description="The reward of this step.")
    reward_total: float
    battery: float = Field(ge=0, le=1, description="Fraction of the battery left.")
    battery_units: Count
    deliveries_done: Count
    delivered: list[Position] = Field(description="[x, y] of the parcels delivered so far.")
    target: Position | None = Field(description="[x, y] of the current target.")
    distance: int | None = Field(description="Manhattan distance to the target in cells.")
    score: Score = Field(description="The graded score; provisional until `done`.")
    efficiency: float = Field(ge=0, le=100, description="The weighted sum of its parts; not the score.")
    efficiency_parts: list[EfficiencyPart]
    message: str = Field(description="The event of this step in words.")
    done: bool
    outcome: OutcomeName
    q_values: dict[Direction, float] | None = Field(
        description="The network's value of each action, from the pilot's own network or else that of `/predict`. "
        "Null without a network, at the end, and for a person who has not turned values on."
    )


class EpisodeView(StrictModel):
    """An episode, frame by frame."""

    opening: FlightHeader
    frames: list[Frame] = Field(description="Frame 0 is the reset; then one per step.")


class BestFlight(StrictModel):
    """A best flight over a map."""

    score: Score = Field(description="The highest possible score.")
    success: bool = Field(description="Whether it delivers all parcels; otherwise battery or steps do not suffice.")
    deliveries: Count
    steps: Count = Field(description="Length in steps.")
    actions: list[Direction] = Field(description="Its actions, in order.")
    path: list[Position] = Field(description="[x, y] of the drone at the start and after each action.")


def frame_of(episode: Episode, network: PathQNetAgent | None = None) -> Frame:
    """The frame of an episode in its current state. With a network, it has the network's value of each action."""
    x, y = episode.position
    last = episode.last_step
    q_values = None if network is None or episode.ended else network.q_values(episode.observation()).tolist()
    return Frame(
        **{name: value for name, value in observation_numbers(episode).items() if name in Frame.model_fields},
        step=episode.steps,
        action=None if last is None else last.action.name,
        x=x,
        y=y,
        event=None if episode.event is Event.NONE else cast(EventName, episode.event.name.lower()),
        reward=episode.reward_last,
        battery_units=episode.battery_units,
        delivered=[(px, py) for px, py, delivered in episode.parcels if delivered],
        target=episode.target,
        distance=episode.distance_to_target,
        efficiency=episode.efficiency,
        efficiency_parts=[
            EfficiencyPart(name=name, weight=weight, share=share, score=score)
            for (name, weight), share, score in zip(
                EFFICIENCY_WEIGHTS.items(), episode.efficiency_shares, episode.score_parts, strict=True
            )
        ],
        outcome=cast(OutcomeName, episode.outcome.name.lower()),
        q_values=None if q_values is None else dict(zip(DIRECTIONS, q_values, strict=True)),
    )


def best_flight(task: TaskConfig, seed: int) -> BestFlight:
    """A best flight over a map: a job of a worker process.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    from drone_env.planning.optimal import solve_episode  # loads Numba, which the process that serves does without

    start = Episode(task, seed=seed)
    # If every step costs the same, the shortest tour needs no solver.
    best = solve_episode(start, None if task.uniform else solver_of_map(task, seed))
    return BestFlight(
        score=best.score,
        success=best.success,
        deliveries=best.deliveries,
        steps=best.steps,
        actions=[DIRECTIONS[action] for action in best.actions],
        path=[start.position, *((step.x, step.y) for step in start.copy().fly(best.actions).path)],
    )


def frames_of(start: Episode, actions: Sequence[int], network: PathQNetAgent | None) -> list[Frame]:
    """The frames of a flight from its start, frame 0 included."""
    episode = start.copy()
    frames = [frame_of(episode, network)]
    for action in actions:
        episode.step(action)
        frames.append(frame_of(episode, network))
    return frames


def network_beside(networks: Networks, provenance: Provenance, episode: Episode) -> PathQNetAgent | None:
    """The network whose values are shown: none to a person in flight who has not turned them on."""
    hidden = provenance.pilot == HUMAN and not provenance.values_used and not episode.ended
    return None if hidden else networks.shown_network(provenance.pilot, episode.task)


def fly_agent(start: Episode, pilot: str) -> tuple[list[int], str]:
    """All actions of an agent's flight, and its frames as a JSON array: a job of a worker process.

    Raises:
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if the network file cannot be used.
        TooLargeError: if the map is too large for the pilot.
    """
    networks = job_networks()
    agent = networks.agent(pilot, start.task)
    assert agent is not None
    agent.reset(start.seed)
    actions = [int(action) for action in rollout(start.copy(), agent.act).actions]
    return actions, to_json(frames_of(start, actions, networks.shown_network(pilot, start.task))).decode()
