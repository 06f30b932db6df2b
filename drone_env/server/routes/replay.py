"""The routes that look at a flight of the past: flown again frame by frame, and analysed move by move."""

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
from drone_env.server.frames import EpisodeView, FlightHeader, frame_of
from drone_env.server.incoming import LARGE_BODY, JsonRoute
from drone_env.server.jobs import bench
from drone_env.server.problems import RequestError, answers
from drone_env.server.state import SharedParts

router = APIRouter(tags=["replay"], route_class=JsonRoute)
RECORD_ERRORS = answers(400, 413, 415, 422, 503)
RECORD = record_of(Episode("easy_delivery", ORIGINAL_PROFILE, 7).fly([Action.UP]), "me")


Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": RECORD.model_dump()}})]


class AnalysedMove(Message):
    """One move, and what it gave away."""

    step: int = Field(ge=1)
    action: Direction
    position: Position = Field(description="[x, y] after it.")
    event: EventName
    value: Score = Field(description="The best score that could still be reached before it.")
    regret: float = Field(ge=0, description="What it gave away for good, in score.")
    label: Label
    mark: str = Field(description="As beside a move of chess: `?!`, `?`, `??`, `!!`, or empty.")
    best_actions: list[Direction] = Field(description="All actions that give nothing away.")
    margin: float = Field(ge=0, description="What the next best action gives away.")


class AnalysedFlight(Message):
    """A flight beside the exact optimum of its map."""

    score: Score
    optimal_score: Score = Field(description="The highest score that any flight over this map can reach.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    accuracy: float | None = Field(description="Share of best moves among those where anything could be lost.")
    counts: dict[Label, int] = Field(description="Moves by label.")
    moves: list[AnalysedMove]
    optimal_steps: Count = Field(description="Steps of a best flight.")
    optimal_actions: list[Direction] = Field(description="Its actions.")
    optimal_path: list[Position] = Field(description="[x, y] of the drone on it, from its start on.")


@router.post("/replay", response_model=EpisodeView, responses=RECORD_ERRORS, openapi_extra=LARGE_BODY)
async def replay_record(request: Request, shared: SharedParts, record: Record) -> Response:
    """Fly a record again, check every reward and the score, and show it frame by frame."""
    return await shared.json(request, _replayed, record, task=record.task)


def _replayed(record: EpisodeRecord) -> str:
    steps = replay_steps(record)
    start = next(steps)
    header = FlightHeader.of(start, record.agent)
    network = bench().networks.beside(header.pilot, start.task)
    frames = [frame_of(episode, network) for episode in chain([start], steps)]
    return EpisodeView(opening=header, frames=frames).model_dump_json()


@router.post(
    "/annotate", response_model=AnalysedFlight, responses=RECORD_ERRORS | answers(409), openapi_extra=LARGE_BODY
)
async def annotate(request: Request, shared: SharedParts, record: Record) -> Response:
    """What each move of a finished flight gave away, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a flight that has ended is annotated")
    return await shared.json(request, _annotated, record, task=record.task)


def _annotated(record: EpisodeRecord) -> str:
    analysis = analyse_flight(record, lambda start: bench().solver_of(start.task, start.seed))
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
    """A best flight over a map, and [x, y] of the drone on it from its start on: for worker processes.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    start = Episode(task, seed=seed)
    # Where every step costs the same, the shortest tour is found without.
    best = solve_episode(start, None if task.uniform else bench().solver_of(task, seed))
    return best, [start.position, *((step.x, step.y) for step in start.copy().fly(best.actions).path)]
