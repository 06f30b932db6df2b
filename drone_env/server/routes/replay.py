"""The routes for finished flights: replay frame by frame, and analysis move by move."""

from itertools import chain
from typing import Annotated

from fastapi import APIRouter, Body, Request, Response
from pydantic import Field

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import TaskConfig
from drone_env.models import DIRECTIONS, Count, Direction, EventName, Message, Position, Score
from drone_env.planning.optimal import Solution, solve_episode
from drone_env.results.analysis import Label, analyse_flight
from drone_env.results.record import EpisodeRecord, record_of, replay_steps
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.frames import EpisodeView, FlightHeader, frame_of
from drone_env.server.jobs import job_context
from drone_env.server.json_routes import LARGE_BODY, JsonRoute
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["replay"], route_class=JsonRoute)
RECORD_ERRORS = error_responses(400, 413, 415, 422, 503)
RECORD = record_of(Episode("easy_delivery", ORIGINAL_PROFILE, 7).fly([Action.UP]), "me")


Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": RECORD.model_dump()}})]


class AnalysedMove(Message):
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


class AnalysedFlight(Message):
    """A flight compared with the exact optimum of its map."""

    score: Score
    optimal_score: Score = Field(description="The highest possible score on this map.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    accuracy: float | None = Field(description="Fraction of best moves among moves with a margin.")
    counts: dict[Label, int] = Field(description="Moves by label.")
    moves: list[AnalysedMove]
    optimal_steps: Count = Field(description="Steps of a best flight.")
    optimal_actions: list[Direction] = Field(description="Its actions.")
    optimal_path: list[Position] = Field(description="[x, y] of the drone from the start.")


@router.post("/replay", response_model=EpisodeView, responses=RECORD_ERRORS, openapi_extra=LARGE_BODY)
async def replay_record(request: Request, shared: AppStateDep, record: Record) -> Response:
    """Replay a record, check its rewards and score, and return its frames."""
    return await shared.json(request, _replayed, record, task=record.task)


def _replayed(record: EpisodeRecord) -> str:
    steps = replay_steps(record)
    start = next(steps)
    header = FlightHeader.of(start, record.agent)
    network = job_context().networks.shown_network(header.pilot, start.task)
    frames = [frame_of(episode, network) for episode in chain([start], steps)]
    return EpisodeView(opening=header, frames=frames).model_dump_json()


@router.post(
    "/annotate", response_model=AnalysedFlight, responses=RECORD_ERRORS | error_responses(409), openapi_extra=LARGE_BODY
)
async def annotate(request: Request, shared: AppStateDep, record: Record) -> Response:
    """The regret of each move of a finished flight, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a finished flight can be annotated")
    return await shared.json(request, _annotated, record, task=record.task)


def _annotated(record: EpisodeRecord) -> str:
    analysis = analyse_flight(record, lambda start: job_context().solver_of(start.task, start.seed))
    best, path = best_flight(analysis.task, analysis.seed)
    answer = AnalysedFlight(
        **{name: getattr(analysis, name) for name in ("score", "regret", "accuracy", "counts")},
        optimal_score=analysis.optimum,
        moves=[AnalysedMove(**move) for move in analysis.to_dict()["moves"]],
        optimal_steps=best.steps,
        optimal_actions=[DIRECTIONS[action] for action in best.actions],
        optimal_path=path,
    )
    return answer.model_dump_json()


def best_flight(task: TaskConfig, seed: int) -> tuple[Solution, list[Position]]:
    """A best flight over a map, and [x, y] of the drone from the start: a job of a worker process.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    start = Episode(task, seed=seed)
    # If every step costs the same, the shortest tour needs no solver.
    best = solve_episode(start, None if task.uniform else job_context().solver_of(task, seed))
    return best, [start.position, *((step.x, step.y) for step in start.copy().fly(best.actions).path)]
