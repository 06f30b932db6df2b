"""The routes that show the runs of language models that are kept here: their leaderboard, and what was asked."""

from functools import partial
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from pydantic import Field

from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.evaluation.comparison import AgentMap, Bounds
from drone_env.llm.prompt import ChatMessage
from drone_env.llm.transcript import Failure
from drone_env.models import Count, Message
from drone_env.server.model_runs import by_map
from drone_env.server.problems import RequestError, answers
from drone_env.server.state import Shared, SharedParts

router = APIRouter(tags=["compare"])


class ModelRun(Message):
    """A run of a language model that was checked: each flight follows from the model's own answers."""

    run: str = Field(description="Name of its folder.")
    model: str
    prompt: str
    flights: Count = Field(description="Those that count.")
    errored: Count = Field(description="Those that were left out, since a request failed for good.")
    waits: Count = Field(description="Steps that are a WAIT because no answer could be used.")
    tokens: Count
    success_rate: float = Field(ge=0, le=1)
    score: float = Field(ge=0, le=1)
    score_ci95: Bounds = Field(description="Over the maps; null for one.")
    regret: float | None
    normalised: float | None = Field(description="(score - random) / (optimum - random) over the same maps.")
    steps: float = Field(description="Mean length in steps, over the maps.")
    maps: list[AgentMap]


class ModelBoard(Message):
    """Runs over the same maps, the best first."""

    maps: str = Field(description="Which maps, in words.")
    rows: list[ModelRun]


class UnrankedRun(Message):
    """A run that is not ranked."""

    run: str = Field(description="Name of its folder.")
    reason: str


class ModelBoards(Message):
    """The runs of language models over a task."""

    task: str = Field(description="Id of the task.")
    boards: list[ModelBoard]
    unranked: list[UnrankedRun]


class ModelCall(Message):
    """One request to a language model, and its answer."""

    step: Count = Field(description="The step that it was made for, from 1; that of a whole route is the first.")
    attempt: Count = Field(description="1, or 2 after an answer that could not be used.")
    messages: list[ChatMessage]
    answer: str | None = Field(
        description="What was answered, in text or as a tool's arguments; null where nothing was."
    )
    reasoning: str | None = Field(description="What the model thought, where the endpoint tells it.")
    outcome: str = Field(description="How the answer was understood: `ok`, or why it was no action.")
    failures: list[Failure] = Field(description="Tries that brought no answer.")
    latency: float = Field(ge=0, description="Seconds that the last try took.")
    cached: bool = Field(description="Whether the answer is from the run's cache.")


class ModelCalls(Message):
    """All requests of one flight, in order: none where no language model flew it, or its run is not kept here."""

    run: str | None = Field(description="Name of the run's folder; null where there is none, as the next two.")
    model: str | None
    prompt: str | None
    calls: list[ModelCall]


@router.get("/leaderboard/{task_name}/models", responses=answers(404, 422, 503))
async def model_boards(shared: SharedParts, task_name: str) -> ModelBoards:
    """Runs of `drone-env infer` over a task, each flown again from the model's own answers before it is ranked.

    They are those in `llm` of the data folder. The first look at a run takes seconds.
    """
    task = get_task(task_name)
    configs = await shared.study(shared.runs.configs)
    chosen = [path for path, config in configs.items() if config is None or config.task == task.id]
    # One by one: other studies may come between.
    judged = [await shared.study(partial(shared.runs.judge, path)) for path in chosen]
    return await shared.study(lambda: _boards(shared, task.id, judged))


def _boards(shared: Shared, task: str, judged: list[Any]) -> ModelBoards:
    from drone_env.evaluation.leaderboard import Judged, Refused, boards_of

    return ModelBoards(
        task=task,
        boards=[
            ModelBoard(maps=board.maps, rows=[_row(shared, row) for row in board.rows])
            for board in boards_of(one for one in judged if isinstance(one, Judged))
        ],
        unranked=[
            UnrankedRun(run=one.path.name, reason=_without_folder(one.reason, one.path))
            for one in judged
            if isinstance(one, Refused)
        ],
    )


def _row(shared: Shared, figures: dict[str, Any]) -> ModelRun:
    path = Path(figures["path"])
    flights = shared.runs.flights(path)
    maps = by_map(
        flights,
        {of_map["seed"]: of_map["optimum"] for of_map in figures["maps"]},
        shared.store.kept(id_ for id_, _ in flights),
    )
    same = ("score", "score_ci95", "regret", "normalised", "success_rate", "waits")
    return ModelRun(
        **{name: figures[name] for name in same},
        run=path.name,
        model=figures["config"]["model"],
        prompt=figures["config"]["prompt"],
        flights=figures["flights"]["counted"],
        errored=figures["flights"]["errored"],
        tokens=sum(figures["tokens"].values()),
        steps=sum(of_map.steps for of_map in maps) / len(maps),
        maps=maps,
    )


@router.get("/episodes/{episode_id}/calls", responses=answers(404, 422, 503))
async def calls(shared: SharedParts, episode_id: str) -> ModelCalls:
    """What a language model was asked at each step of a flight, and what it answered."""
    return await shared.study(lambda: _calls(shared, episode_id))


def _calls(shared: Shared, episode_id: str) -> ModelCalls:
    try:
        found = shared.runs.calls(episode_id)
    except InvalidValueError:
        # Not the error itself: it names the folder.
        raise RequestError(404, "damaged_run", "the run of this flight is damaged: see drone-env leaderboard") from None
    if found is None:
        shared.store.episode(episode_id)
        return ModelCalls(run=None, model=None, prompt=None, calls=[])
    path, config, asked = found
    return ModelCalls(
        run=path.name,
        model=config.model,
        prompt=config.prompt,
        calls=[
            ModelCall(
                # A turn is a step: a whole route is planned in the first one.
                step=call.turn,
                attempt=call.attempt,
                messages=call.messages,
                answer=None if call.answer is None else call.answer.tool_arguments or call.answer.text,
                reasoning=None if call.answer is None else call.answer.reasoning,
                outcome=call.outcome,
                failures=call.failures,
                latency=call.latency,
                cached=call.cached,
            )
            for call in asked
        ],
    )


def _without_folder(reason: str, path: Path) -> str:
    """Strangers need not know where the folder is."""
    return reason.replace(str(path), path.name)
