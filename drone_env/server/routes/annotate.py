"""The route that analyses a flight move by move."""

from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import Field

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import TooLargeError
from drone_env.flights.record import EpisodeRecord, replay
from drone_env.models import DIRECTIONS, Count, Direction, EventName, Position, Score, StrictModel
from drone_env.results.analysis import Label, analyse_flight, find_loops, plain, why_failed
from drone_env.server.best_flights import best_flight, network_flight
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.routes.replay import FLIGHT_ERRORS, Record
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["replay"], route_class=JsonRoute)


class AnalysedMove(StrictModel):
    """One move and its regret."""

    step: int = Field(ge=1)
    action: Direction
    position: Position = Field(description="[x, y] after it.")
    event: EventName
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
    idle: Count = Field(description="Steps after which the battery was no fuller than before in this loop.")
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

    unsolved: str | None = Field(description="Why there is no optimum; null if the map is solved.")
    score: Score
    optimal_score: Score | None = Field(description="The highest possible score on this map.")
    regret: float | None = Field(ge=0, description="optimal_score - score.")
    accuracy: float | None = Field(description="Fraction of best moves among moves with a margin.")
    counts: dict[Label, int] = Field(description="Moves by label.")
    moves: list[AnalysedMove] = Field(description="Empty if the map is not solved.")
    loops: list[FlownLoop]
    worst: Worst | None = Field(
        description="What lost most, the first of equals; null if nothing was lost. If the map is not solved, the loop "
        "with the most idle steps."
    )
    why: str = Field(description="Why it failed, in one sentence; empty if it delivered all parcels.")
    rescue_step: Count | None = Field(
        description="The last step after which all parcels could still be delivered; null if there is none, or if all "
        "were delivered."
    )
    network: str | None = Field(description="Id of the pilot by whose network the map was flown; null without one.")
    network_score: Score | None = Field(description="Its score.")
    optimal_steps: Count | None = Field(description="Steps of a best flight.")
    optimal_battery: Count | None = Field(description="Battery units left at its end.")
    optimal_actions: list[Direction] = Field(description="Its actions.")
    optimal_path: list[Position] = Field(description="[x, y] of the drone from the start.")


@router.post(
    "/annotate", response_model=AnalysedFlight, responses=FLIGHT_ERRORS | error_responses(409), openapi_extra=LARGE_BODY
)
async def annotate(request: Request, app_state: AppStateDep, record: Record) -> Response:
    """The regret of each move of a finished flight, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a finished flight can be annotated")
    return await app_state.json(request, _annotated, record, task=record.task)


def _annotated(record: EpisodeRecord) -> str:
    known: dict[str, Any]
    try:
        known = _compared(record)
    except TooLargeError as error:
        flown = replay(record)
        loops = find_loops(flown)
        idlest = max(loops, key=lambda loop: loop.idle, default=None)
        unknown = ("optimal_score", "regret", "accuracy", "rescue_step", "optimal_steps", "optimal_battery")
        known = {
            **dict.fromkeys(unknown),
            "unsolved": str(error),
            "score": flown.score,
            "why": why_failed(flown),
            "loops": loops,
            "worst": idlest and Worst(first=idlest.first, last=idlest.last, regret=None, why=idlest.words),
            "counts": {},
            "moves": [],
            "optimal_actions": [],
            "optimal_path": [],
        }
    known["loops"] = [FlownLoop(**plain(vars(loop))) for loop in known["loops"]]
    network, network_score = network_flight(get_task(record.task), record.seed)
    return AnalysedFlight(network=network, network_score=network_score, **known).model_dump_json()


def _compared(record: EpisodeRecord) -> dict[str, Any]:
    """The fields that compare a flight with the optimum of its map."""
    analysis = analyse_flight(record, lambda start: job_context().solver_of(start.task, start.seed))
    best, path = best_flight(analysis.task, analysis.seed)
    worst, why = analysis.worst, analysis.why
    return {
        **{name: getattr(analysis, name) for name in ("score", "regret", "accuracy", "counts", "loops", "why")},
        "unsolved": None,
        "worst": worst and Worst(first=worst.first, last=worst.last, regret=worst.regret, why=analysis.worst_why),
        "rescue_step": analysis.rescue_step if why else None,
        "optimal_score": analysis.optimum,
        "moves": [AnalysedMove(**plain(vars(move))) for move in analysis.moves],
        "optimal_steps": best.steps,
        "optimal_actions": [DIRECTIONS[action] for action in best.actions],
        "optimal_battery": Episode(analysis.task, seed=analysis.seed).fly(best.actions).battery_units,
        "optimal_path": path,
    }
