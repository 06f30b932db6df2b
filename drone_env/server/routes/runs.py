"""The routes for evaluations and runs of language models, and for the calls of a model."""

from pathlib import Path
from statistics import fmean
from typing import Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import ChatMessage
from drone_env.llm.transcript import Failure
from drone_env.models import Count, StrictModel
from drone_env.results.folder import SHIPPED
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, group_by_maps
from drone_env.results.statistics import Bounds
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.jobs import job_context
from drone_env.server.model_runs import StoredRuns, is_agent, run_name, shown_agent
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["compare"])


class Run(StrictModel):
    """The results of an agent or a language model over the maps of a board.

    The server replays every flight of a model from its responses. Evaluations store no actions; the server checks that
    no score exceeds the optimum of its map.
    """

    run: str = Field(description="Name of its folder; `drone-env VERSION` for the shipped results.")
    shipped: bool = Field(description="Whether the results are shipped with the package.")
    kind: Literal["agent", "model"] = Field(description="From `drone-env evaluate`, or from `drone-env infer`.")
    agent: str = Field(description="The model, or the agent as in `drone-env evaluate`.")
    prompt: str | None = Field(description="Name of the prompt; this and the next six are null for an agent.")
    errored: Count | None = Field(description="Flights left out because a request failed.")
    waits: Count | None = Field(description="Steps that are a WAIT because no response was usable.")
    unusable_share: float | None = Field(description="Fraction of responses that stayed unusable after a repair.")
    marked: bool = Field(description="Whether `unusable_share` is over 5 %: the score is not reliable.")
    tokens: Count | None = Field(description="Also null if no response reports its tokens.")
    without_usage: Count | None = Field(description="Responses without a count of tokens, which `tokens` leaves out.")
    flights: Count = Field(description="Flights that count.")
    success_rate: float = Field(ge=0, le=1)
    score: float = Field(ge=0, le=1)
    score_ci95: Bounds = Field(description="Over the maps; null for one.")
    regret: float | None
    normalised: float | None = Field(description="(score - random) / (optimum - random) over the same maps.")
    steps: float = Field(description="Mean length in steps, over the maps.")
    maps: Count = Field(description="Number of maps; `/leaderboard/{task_name}/maps` lists them.")


class RunBoard(StrictModel):
    """Runs over the same maps, the best first."""

    maps: str = Field(description="The maps in words.")
    rows: list[Run]


class UnrankedRun(StrictModel):
    """A run that is not ranked."""

    run: str = Field(description="Name of its folder.")
    reason: str


class RunBoards(StrictModel):
    """The evaluations and runs of models over a task."""

    task: str = Field(description="Id of the task.")
    boards: list[RunBoard]
    unranked: list[UnrankedRun]


class ModelCall(StrictModel):
    """One request to a language model, and its response."""

    step: Count = Field(description="The step of the request, from 1; 1 for a whole route.")
    attempt: Count = Field(description="1, or 2 after an unusable response.")
    messages: list[ChatMessage]
    answer: str | None = Field(description="The text or the tool's arguments; null without a response.")
    reasoning: str | None = Field(description="The model's reasoning, if the endpoint returns it.")
    outcome: str = Field(description="`ok`, or why the response is not an action.")
    failures: list[Failure] = Field(description="Attempts without a response.")
    latency: float = Field(ge=0, description="Duration of the last attempt in seconds.")


class ModelCalls(StrictModel):
    """All requests of one flight, in order; none if no run in the data folder flew it."""

    run: str | None = Field(description="Name of the run's folder; null without a run, as the next two.")
    model: str | None
    prompt: str | None
    calls: list[ModelCall]


@router.get("/leaderboard/{task_name}/runs", response_model=RunBoards, responses=error_responses(404, 422, 503))
async def run_boards(request: Request, app_state: AppStateDep, task_name: str) -> Response:
    """Evaluations and language models side by side, over the same maps of a task.

    The package contains an evaluation of its agents. The data folder contains evaluations (`drone-env evaluate --out`)
    in `evaluations`, and runs of `drone-env infer` in `llm`. The server replays a run from the model's responses before
    it ranks the run; the first request takes seconds.
    """
    task = await run_in_threadpool(get_task, task_name)
    runs = app_state.runs
    paths = await run_in_threadpool(runs.folders, task.id)
    if paths == [SHIPPED]:
        return Response(await run_in_threadpool(_boards, runs, task.id), media_type="application/json")
    # One job per folder: each has its own time limit, and its worker caches the result.
    for path in paths:
        await app_state.work(request, _load, path, task.id)
    return await app_state.json(request, _boards_of_worker, task.id)


def _load(path: Path, task: str) -> None:
    job_context().runs.entries(path, task)


def _boards_of_worker(task: str) -> str:
    return _boards(job_context().runs, task)


def _boards(runs: StoredRuns, task: str) -> str:
    entries = [entry for path in runs.folders(task) for entry in runs.entries(path, task)]
    return RunBoards(
        task=task,
        boards=[
            RunBoard(maps=board.maps, rows=[_row(entry) for entry in board.rows])
            for board in group_by_maps(entry for entry in entries if isinstance(entry, LeaderboardEntry))
        ],
        unranked=[
            UnrankedRun(run=run_name(entry.path), reason=_without_folder(entry.reason, entry.path))
            for entry in entries
            if isinstance(entry, NotRanked)
        ],
    ).model_dump_json()


def _row(entry: LeaderboardEntry) -> Run:
    report, results, of_model = entry.report, entry.results.by_map(), not is_agent(entry)
    rows = results.rows()
    return Run(
        **{name: report[name] for name in ("score", "score_ci95", "regret", "normalised", "success_rate")},
        run=run_name(entry.path),
        shipped=entry.path == SHIPPED,
        kind="model" if of_model else "agent",
        agent=shown_agent(entry.agent),
        prompt=report["config"].get("prompt"),
        errored=report["flights"]["errored"] if of_model else None,
        waits=report.get("waits"),
        unusable_share=report["unusable"]["share"] if of_model else None,
        marked=of_model and report["unusable"]["marked"],
        tokens=report["tokens"]["total"] if of_model else None,
        without_usage=report["calls"]["without_usage"] if of_model else None,
        flights=sum(row.flights for row in rows),
        steps=fmean(results.steps),
        maps=len(rows),
    )


@router.get("/episodes/{episode_id}/calls", response_model=ModelCalls, responses=error_responses(404, 422, 503))
async def calls(request: Request, app_state: AppStateDep, episode_id: str) -> Response:
    """The requests to a language model at each step of a flight, and its responses."""
    found = await app_state.work(request, _calls, episode_id)
    if found is None:
        await run_in_threadpool(app_state.store.episode, episode_id)
        found = ModelCalls(run=None, model=None, prompt=None, calls=[]).model_dump_json()
    return Response(found, media_type="application/json")


def _calls(episode_id: str) -> str | None:
    try:
        found = job_context().runs.calls(episode_id)
    except InvalidValueError:
        # The error itself would reveal the folder.
        raise RequestError(404, "damaged_run", "the run of this flight is damaged: see drone-env leaderboard") from None
    if found is None:
        return None
    path, config, calls = found
    same = ("attempt", "messages", "outcome", "failures", "latency")
    return ModelCalls(
        run=path.name,
        model=config.model,
        prompt=config.prompt,
        calls=[
            ModelCall(
                **{name: getattr(call, name) for name in same},
                step=call.turn,
                answer=None if call.answer is None else call.answer.tool_arguments or call.answer.text,
                reasoning=None if call.answer is None else call.answer.reasoning,
            )
            for call in calls
        ],
    ).model_dump_json()


def _without_folder(reason: str, path: Path) -> str:
    """Hide the path of the data folder."""
    return " ".join(map(shown_agent, reason.replace(str(path), path.name).split(" ")))
