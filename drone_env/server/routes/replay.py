"""The routes that look at a flight of the past: flown again frame by frame, and annotated move by move."""

from typing import Annotated, cast

from fastapi import APIRouter, Body, Response
from pydantic import Field

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.episodes.record import EpisodeRecord, replay
from drone_env.evaluation.analysis import FlightAnalysis, Label, Move, analyse_flight
from drone_env.models import Count, Direction, EventName, Message, Position, Score
from drone_env.planning.optimal import Solution, solve
from drone_env.server.frames import Frame, Mission, frames_of
from drone_env.server.problems import RequestError, answers
from drone_env.server.state import SharedParts

router = APIRouter(tags=["replay"])
RECORD_ERRORS = answers(400, 413, 415, 422, 503)
RECORD = EpisodeRecord(
    task="easy_delivery",
    task_version=1,
    seed=7,
    agent="me",
    reward_profile="tiered",
    actions=["UP"],
    rewards=[0.15],
    deliveries=0,
    success=False,
    score=0.19666666666666666,
    ended=False,
)
Record = Annotated[EpisodeRecord, Body(openapi_examples={"one step": {"value": RECORD.model_dump()}})]


class Flight(Message):
    """A flight, frame by frame."""

    mission: Mission
    frames: list[Frame] = Field(description="Frame 0 is the reset; then one per step.")


class AnnotatedMove(Message):
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

    @classmethod
    def of(cls, move: Move) -> "AnnotatedMove":
        """The move as it travels."""
        return cls(
            step=move.step,
            action=_name(move.action),
            position=move.position,
            event=cast(EventName, move.event.name.lower()),
            value=move.value,
            regret=move.regret,
            label=move.label,
            mark=move.mark,
            best_actions=[_name(action) for action in move.best_actions],
            margin=move.margin,
        )


class Annotation(Message):
    """A flight beside the exact optimum of its map."""

    score: Score
    optimal_score: Score = Field(description="The highest score that any flight over this map can reach.")
    regret: float = Field(ge=0, description="optimal_score - score.")
    accuracy: float | None = Field(
        description="Share of best moves among those where anything could be lost; null where there was none."
    )
    counts: dict[Label, int] = Field(description="Moves by label.")
    moves: list[AnnotatedMove]
    optimal_steps: Count = Field(description="Steps of a best flight.")
    optimal_actions: list[Direction] = Field(description="Its actions.")
    optimal_path: list[Position] = Field(description="[x, y] of the drone on it, from its start on.")


@router.post("/replay", response_model=Flight, responses=RECORD_ERRORS)
async def replay_record(shared: SharedParts, record: Record) -> Response:
    """Fly a record again, check every reward and the score, and show it frame by frame."""

    def flight() -> Response:
        flown = replay(record)
        start = Episode(flown.task, flown.reward_profile)
        start.reset(flown.seed)
        mission = Mission.of(start, record.agent)
        frames = frames_of(start, flown.actions, shared.networks, record.agent)
        return _json(Flight(mission=mission, frames=list(frames)))

    return await shared.study(flight)


@router.post("/annotate", response_model=Annotation, responses=RECORD_ERRORS | answers(409))
async def annotate(shared: SharedParts, record: Record) -> Response:
    """What each move of a finished flight gave away, and a best flight over its map. Large maps take seconds."""
    if not record.ended:
        raise RequestError(409, "in_flight", "only a flight that has ended is annotated")

    def annotation() -> Response:
        analysis = analyse_flight(record)
        best, path = best_flight(analysis.task, analysis.seed)
        return _json(_annotation(analysis, best, path))

    return await shared.study(annotation)


def best_flight(task: TaskConfig, seed: int) -> tuple[Solution, list[Position]]:
    """A best flight over a map, and [x, y] of the drone on it from its start on.

    Raises:
        TooLargeError: if the map is too large to be solved.
    """
    best = solve(task, seed)
    flight = Episode(task)
    flight.reset(seed)
    path = [flight.position]
    for action in best.actions:
        flight.step(action)
        path.append(flight.position)
    return best, path


def _annotation(analysis: FlightAnalysis, best: Solution, path: list[Position]) -> Annotation:
    return Annotation(
        score=analysis.score,
        optimal_score=analysis.optimum,
        regret=analysis.regret,
        accuracy=analysis.accuracy,
        counts=dict(analysis.counts),
        moves=[AnnotatedMove.of(move) for move in analysis.moves],
        optimal_steps=best.steps,
        optimal_actions=[_name(action) for action in best.actions],
        optimal_path=path,
    )


def _json(answer: Message) -> Response:
    # Made in the thread of its study: FastAPI would do it where all requests are served.
    return Response(answer.model_dump_json(), media_type="application/json")


def _name(action: int) -> Direction:
    return Action(action).name
