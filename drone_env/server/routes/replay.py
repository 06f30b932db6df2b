"""The routes that look at a flight: its frames, the regret of each move, what can still be reached from a moment."""

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast

import numpy as np
from fastapi import APIRouter, Body, Request, Response
from pydantic import ConfigDict, Field

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.rules import score
from drone_env.core.tables import interpreted, view
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import TooLargeError
from drone_env.flights.record import EpisodeRecord, fly_directions, record_of, replay
from drone_env.models import DIRECTIONS, Count, Direction, Position, Score, Seed, StrictModel
from drone_env.results.analysis import Label, analyse_actions, analyse_flight, find_loops, why_failed
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.frames import BestFlight, EpisodeView, FlightHeader, best_flight, frames_of
from drone_env.server.jobs import job_networks, solver_of_map
from drone_env.server.state import AppStateDep

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

router = APIRouter(tags=["replay"])
FLIGHT_ERRORS = error_responses(400, 413, 415, 422, 503)
RECORD = record_of(Episode("easy_delivery", ORIGINAL_PROFILE, 7).fly([Action.UP]), "me")
Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": json.loads(RECORD.to_json())}})]
Part = TypeVar("Part", bound=StrictModel)
Item = TypeVar("Item")
Rows = list[list[Item | None]]
"""[y][x], null at cells without a value."""


class AnalysedMove(StrictModel):
    """One move and its regret."""

    step: int = Field(ge=1)
    value: Score = Field(description="The best score still possible before it.")
    regret: float = Field(ge=0, description="Score that it lost for good.")
    label: Label
    mark: str = Field(description="Annotation symbol as in chess: `?!`, `?`, `??`, `!!`, or empty.")
    best_actions: list[Direction] = Field(description="All actions without regret.")
    margin: float = Field(ge=0, description="Regret of the next best action.")


class FlownLoop(StrictModel):
    """Steps that repeat the same actions over the same cells and deliver nothing."""

    first: int = Field(ge=1, description="Its first step.")
    last: int = Field(ge=1, description="Its last step, which ends a round.")
    actions: list[Direction] = Field(description="The actions of one round.")
    words: str = Field(description="What the drone did: `circled a pad for 63 steps`.")
    regret: float | None = Field(ge=0, description="Score that all its moves lost; null if the map is not solved.")
    label: Label | None
    mark: str


class Worst(StrictModel):
    """The move or the whole loop that lost most."""

    first: int = Field(ge=1, description="Its first step.")
    last: int = Field(ge=1, description="Its last step; the same for a move.")
    regret: float | None = Field(ge=0, description="Score that it lost; null if the map is not solved.")
    why: str = Field(description="`LEFT saves 2 steps` of a move, `circled a pad for 63 steps` of a loop.")


class AnalysedFlight(StrictModel):
    """A flight compared with the exact optimum of its map; without one, all that is known of the flight."""

    score: Score
    unsolved: str | None = Field(default=None, description="Why there is no optimum; null if the map is solved.")
    optimum: BestFlight | None = Field(default=None, description="A best flight over the map.")
    moves: list[AnalysedMove] = Field(default=[], description="Empty if the map is not solved.")
    loops: list[FlownLoop]
    worst: Worst | None = Field(
        description="What lost most, the first of equals; null if nothing was lost. If the map is not solved, the loop "
        "with the most idle steps."
    )
    why: str = Field(description="Why it failed, in one sentence; empty if it delivered all parcels.")
    rescue_step: Count | None = Field(
        default=None,
        description="The last step after which all parcels could still be delivered; null if there is none, or if all "
        "were delivered.",
    )


class FlightSoFar(StrictModel):
    """A flight up to a step: the map, and the actions so far."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"task": "hard", "seed": 7, "actions": ["UP", "LEFT"]}]},
    )

    task: str = Field(max_length=100, description="Id or short name of the task.")
    seed: Seed = Field(description="Number of the map.")
    actions: list[Direction] = Field(
        default=[], max_length=MAX_UNITS, fail_fast=True, description="The actions so far, in order."
    )
    only: Literal["range", "moves"] | None = Field(
        default=None,
        description="`range`: compute only `range`; `moves`: all but `range` and `cells`; null: all.",
    )


class CellValues(StrictModel):
    """Values if the drone were at each cell, [y][x], in an otherwise equal state; null where it cannot be.

    A parcel at the cell counts as delivered. A pad there has not charged the battery yet.
    """

    values: Rows[Score] = Field(description="The best score still possible.")
    q_values: Rows[list[Score]] = Field(
        description="The best score after UP, DOWN, LEFT, RIGHT and WAIT; null where the flight has ended."
    )


class FlightValues(StrictModel):
    """What can still be reached after a step of a flight. Fields that the request did not ask for are null."""

    position: Position = Field(description="[x, y] of the drone.")
    unsolved: str | None = Field(default=None, description="Why the exact values are null.")
    optimum: Score | None = Field(default=None, description="The highest possible score on this map.")
    value: Score | None = Field(default=None, description="The best score still possible; after the end, the score.")
    regret: float | None = Field(default=None, ge=0, description="optimum - value: the score lost for good.")
    along: list[Score] | None = Field(default=None, description="`value` before each action and at the end.")
    q_values: dict[Direction, float] | None = Field(
        default=None, description="The best score after each action; null after the end."
    )
    cells: CellValues | None = Field(default=None, description="The values at each cell; null after the end.")
    range: Rows[Count] | None = Field(
        default=None,
        description="[y][x], the most battery units left on arrival at each cell, in the steps left and without "
        "charging; 0 ends the flight there, null is out of range. Null after the end.",
    )


@router.post("/replay", response_model=EpisodeView, responses=FLIGHT_ERRORS)
async def replay_record(request: Request, app_state: AppStateDep, record: Record) -> Response:
    """Replay a record, check its rewards and score, and return its frames."""
    return await app_state.json(request, _replayed, record, task=record.task)


@router.post("/annotate", response_model=AnalysedFlight, responses=FLIGHT_ERRORS | error_responses(409))
async def annotate(request: Request, app_state: AppStateDep, record: Record) -> Response:
    """The regret of each move of a finished flight, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a finished flight can be annotated")
    return await app_state.json(request, _annotated, record, task=record.task)


@router.post("/values", response_model=FlightValues, responses=FLIGHT_ERRORS)
async def values(request: Request, app_state: AppStateDep, flight: Annotated[FlightSoFar, Body()]) -> Response:
    """The best score still possible after a step of a flight, for each action and from every cell of the map.

    The response also contains the range of the battery. It requires no session. If the map is too large to be solved,
    the exact values are null.
    """
    return await app_state.json(request, _values, flight, task=flight.task)


def _replayed(record: EpisodeRecord) -> str:
    flown = replay(record)
    start = Episode(flown.task, flown.reward_profile, flown.seed)
    header = FlightHeader.at_start(start, record.provenance)
    network = job_networks().shown_network(header.pilot, start.task)
    return EpisodeView(opening=header, frames=frames_of(start, flown.actions, network)).model_dump_json()


def _solver_from(start: Episode) -> "Solver":
    return solver_of_map(start.task, start.seed)


def _annotated(record: EpisodeRecord) -> str:
    flown: dict[str, Any]
    try:
        analysis = analyse_flight(record, _solver_from)
        worst, why, loops = analysis.worst, analysis.why, analysis.loops
        flown = {
            "score": analysis.score,
            "optimum": best_flight(analysis.task, record.seed),
            "moves": [_part(AnalysedMove, move) for move in analysis.moves],
            "worst": worst and Worst(first=worst.first, last=worst.last, regret=worst.regret, why=analysis.worst_why),
            "rescue_step": analysis.rescue_step if why else None,
        }
    except TooLargeError as error:
        episode = replay(record)
        why, loops = why_failed(episode), find_loops(episode)
        idlest = max(loops, key=lambda loop: loop.idle, default=None)
        worst = idlest and Worst(first=idlest.first, last=idlest.last, regret=None, why=idlest.words)
        flown = {"score": episode.score, "unsolved": str(error), "worst": worst}
    found = [_part(FlownLoop, loop) for loop in loops]
    return AnalysedFlight(**flown, why=why, loops=found).model_dump_json()


def _part(model: type[Part], part: object) -> Part:
    """The fields of a move or a loop that a model has, with the names of actions."""
    fields: dict[str, Any] = {name: getattr(part, name) for name in model.model_fields}
    actions = {name: cast(tuple[Action, ...], value) for name, value in fields.items() if isinstance(value, tuple)}
    return model(**fields | {name: [action.name for action in value] for name, value in actions.items()})


def _values(flight: FlightSoFar) -> str:
    start = Episode(get_task(flight.task), seed=flight.seed)
    episode = fly_directions(start.copy(), flight.actions)
    found: dict[str, Any] = {}
    if flight.only != "moves" and not episode.ended:
        # Loads Numba, which the process that serves does without.
        from drone_env.planning.cell_states import battery_range

        units = battery_range(episode, episode.cell, episode.battery_units).astype(object)
        units[units < 0] = None
        found["range"] = _rows(episode, units)
    if flight.only != "range":
        try:
            found |= _exact_values(start, episode, cells=flight.only is None)
        except TooLargeError as error:
            found["unsolved"] = str(error)
    return FlightValues(position=episode.position, **found).model_dump_json()


def _exact_values(start: Episode, episode: Episode, cells: bool) -> dict[str, Any]:
    analysis = analyse_actions(start, episode.actions, _solver_from)
    along = list(analysis.values)
    found: dict[str, Any] = {"optimum": along[0], "value": along[-1], "regret": along[0] - along[-1], "along": along}
    if not episode.ended:
        found["q_values"] = dict(zip(DIRECTIONS, analysis.solver.q_values(episode).tolist(), strict=True))
        found["cells"] = _cell_values(episode, analysis.solver) if cells else None
    return found


def _cell_values(episode: Episode, solver: "Solver") -> CellValues:
    from drone_env.planning.cell_states import states_in_chunks

    tables = interpreted(episode.task)
    values, q_values = np.full((2, len(episode.grid().ravel())), None, object)
    for places in states_in_chunks(episode):
        flying, over = places.cells[places.flying], places.cells[~places.flying]
        after = solver.q_values_of(places.grids[places.flying], places.states[places.flying])
        values[flying] = after.max(axis=1)
        values[over] = [score(tables, view(state)) for state in places.states[~places.flying]]
        for cell, row in zip(flying, after.tolist(), strict=True):
            q_values[cell] = row
    return CellValues(values=_rows(episode, values), q_values=_rows(episode, q_values))


def _rows(episode: Episode, cells: Any) -> list[Any]:
    return cells.reshape(episode.task.height, episode.task.width).tolist()
