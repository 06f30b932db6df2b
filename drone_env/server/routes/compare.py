"""The routes that compare agents and language models, and show the calls of a model."""

from dataclasses import replace
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from drone_env.core.tasks import get_task
from drone_env.errors import UnknownNameError
from drone_env.flights.provenance import Provenance
from drone_env.llm.transcript import Call
from drone_env.models import Count, StrictModel
from drone_env.results.folder import SHIPPED
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, group_by_maps
from drone_env.results.result import Result, Results, results_by_agent
from drone_env.results.statistics import DIFFERENCES, Bounds, PairedComparison, Summary, ci95, mean_of, ranked
from drone_env.server.exceptions import error_responses
from drone_env.server.model_runs import (
    Entries,
    folder_entries,
    identity_of,
    model_calls,
    result_folders,
    run_name,
)
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["compare"])
AgentQuery = Annotated[str, Query(max_length=200, description="The agent as in the records.")]
RunQuery = Annotated[str | None, Query(max_length=200, description="A run; without it, the flights of this server.")]
ERRORS = error_responses(404, 422, 503)


class Means(StrictModel):
    """Means over maps; intervals (95 %) are null for one map."""

    agent: str = Field(description="The agent as in the records, or the language model.")
    flights: Count
    maps: Count = Field(description="Number of different maps.")
    success_rate: float = Field(ge=0, le=1, description="Fraction of flights that delivered everything.")
    success_ci95: Bounds
    score: float = Field(ge=0, le=1, description="Mean graded score.")
    score_ci95: Bounds
    regret: float | None = Field(description="Mean of optimum - score, over the maps whose optimum is known.")
    regret_ci95: Bounds
    regret_maps: Count = Field(description="Number of these maps; the others are being solved or are too large.")
    steps: float = Field(description="Mean length in steps.")


def _means(summary: Summary) -> dict[str, Any]:
    return {name: value for name, value in vars(summary).items() if name in Means.model_fields}


class LeaderboardRow(Means):
    """One agent over the maps of a task that it flew."""

    by: Provenance = Field(description="The agent as fields.")


class Leaderboard(StrictModel):
    """All agents of a task by mean regret, the lowest first, without forks."""

    task: str = Field(description="Id of the task.")
    rows: list[LeaderboardRow]
    forks: Count = Field(description="Number of forks, which are left out.")


class Run(Means):
    """The results of an agent or a language model over the maps of a board.

    The server replays every flight of a model from its responses. Evaluations store no actions; the server checks that
    no score exceeds the optimum of its map.
    """

    run: str = Field(description="Name of its folder; `drone-env VERSION` for the shipped results.")
    shipped: bool = Field(description="Whether the results are shipped with the package.")
    kind: Literal["agent", "model"] = Field(description="From `drone-env evaluate`, or from `drone-env infer`.")
    normalised: float | None = Field(description="(score - random) / (optimum - random) over the same maps.")
    prompt: str | None = Field(description="Name of the prompt; null for an agent, as the next one.")
    unusable_share: float | None = Field(description="Fraction of responses that stayed unusable after a repair.")
    marked: bool = Field(description="Whether `unusable_share` is over 5 %: the score is not reliable.")


class RunBoard(StrictModel):
    """Runs over the same maps, the best first."""

    maps: str = Field(description="The maps in words.")
    rows: list[Run]


class RunBoards(StrictModel):
    """The evaluations and runs of models over a task."""

    boards: list[RunBoard]
    unranked: list[dict[str, str]] = Field(description="`run`, the folder, and `reason` of those that are not ranked.")


class PairedMap(StrictModel):
    """One map that both agents flew."""

    difference: float = Field(description="Score of a - score of b.")
    a: Result
    b: Result


class Pairing(StrictModel):
    """Two agents over their common maps."""

    maps: Count
    difference: float | None = Field(description="Mean of score of a - score of b; null without maps.")
    ci95: Bounds = Field(description="Its 95 % interval; null for fewer than two maps.")
    wins: Count = Field(description="Maps on which a scored higher.")
    ties: Count
    losses: Count
    pairs: list[PairedMap] = Field(description="One entry per map, by number.")


class ModelCalls(StrictModel):
    """All requests of one flight to a language model, in order; none if no run in the data folder flew it."""

    model: str | None
    calls: list[Call]


@router.get("/leaderboard/{task_name}", responses=ERRORS)
def leaderboard(app_state: AppStateDep, task_name: str) -> Leaderboard:
    """The agents of a task over all finished flights; flights of an agent over the same map count as their mean."""
    maps = app_state.store.means_by_map(task_name)
    own = {row["agent"]: row for row in maps if row["parent"] is None}
    who = ("pilot", "person", "values_used", "undo_used")
    rows = [
        LeaderboardRow(
            **_means(summary),
            agent=agent,
            by=Provenance.model_validate({name: own[agent][name] for name in who}, strict=False),
        )
        for agent, summary in ranked(results_by_agent(row for row in maps if row["parent"] is None))
    ]
    forks = sum(row["flights"] for row in maps if row["parent"] is not None)
    return Leaderboard(task=get_task(task_name).id, rows=rows, forks=forks)


@router.get("/leaderboard/{task_name}/runs", responses=ERRORS)
async def run_boards(request: Request, app_state: AppStateDep, task_name: str) -> RunBoards:
    """Evaluations and language models side by side, over the same maps of a task.

    The package contains an evaluation of its agents. The data folder contains evaluations (`drone-env evaluate --out`)
    in `evaluations`, and runs of `drone-env infer` in `llm`. The server replays a run from the model's responses before
    it ranks the run; the first request takes seconds.
    """
    entries = await _entries(request, app_state, task_name)
    boards = group_by_maps(entry for entry in entries if isinstance(entry, LeaderboardEntry))
    unranked = [entry for entry in entries if isinstance(entry, NotRanked)]
    return RunBoards(
        boards=[RunBoard(maps=board.maps, rows=[_row(entry) for entry in board.rows]) for board in boards],
        unranked=[{"run": run_name(entry.path), "reason": entry.reason} for entry in unranked],
    )


@router.get("/leaderboard/{task_name}/maps", responses=ERRORS)
async def agent_maps(
    request: Request, app_state: AppStateDep, task_name: str, agent: AgentQuery, run: RunQuery = None
) -> dict[str, list[Result]]:
    """The maps of a task that an agent flew, with its results, as `maps`."""
    return {"maps": (await _flown(request, app_state, task_name, agent, run)).rows()}


@router.get("/paired/{task_name}", responses=ERRORS)
async def pair(
    request: Request,
    app_state: AppStateDep,
    task_name: str,
    a: AgentQuery,
    b: AgentQuery,
    run_a: RunQuery = None,
    run_b: RunQuery = None,
) -> Pairing:
    """Two agents over the maps of a task that both flew, map by map."""
    both = [await _flown(request, app_state, task_name, *one) for one in ((a, run_a), (b, run_b))]
    paired = PairedComparison.of(*both)
    wins, ties, losses = paired.outcomes
    rows = zip(paired.differences.tolist(), paired.a.rows(), paired.b.rows(), strict=True)
    return Pairing(
        maps=len(paired.differences),
        difference=mean_of(paired.differences),
        ci95=ci95(paired.differences, DIFFERENCES),
        wins=wins,
        ties=ties,
        losses=losses,
        pairs=[PairedMap(difference=difference, a=a, b=b) for difference, a, b in rows],
    )


@router.get("/episodes/{episode_id}/calls", responses=ERRORS)
async def calls(request: Request, app_state: AppStateDep, episode_id: str) -> ModelCalls:
    """The requests to a language model in a flight, and its responses."""
    model, calls = await app_state.work(request, model_calls, app_state.settings.data, episode_id)
    return ModelCalls(model=model, calls=calls)


async def _entries(request: Request, app_state: AppState, task_name: str, run: str | None = None) -> Entries:
    """The entries of the runs over a task, or of those of one name. Cached until a file changes."""
    task = await run_in_threadpool(get_task, task_name)
    folders = await run_in_threadpool(result_folders, app_state.settings.data, task.id)
    named = [path for path in folders if run in (None, run_name(path))]
    if not named:
        raise UnknownNameError("run", str(run), map(run_name, folders))
    found: Entries = []
    for path in named:
        identity = await run_in_threadpool(identity_of, path)
        known, entries = app_state.results.get((path, task.id), (None, Entries()))
        if known != identity:
            # One job per folder: each has its own time limit.
            entries = await app_state.work(request, folder_entries, path, task.id)
            app_state.results[path, task.id] = identity, entries
        found += entries
    return found


def _row(entry: LeaderboardEntry) -> Run:
    unusable = entry.report.get("unusable", {})
    return Run(
        **_means(entry.summary),
        agent=entry.agent,
        run=run_name(entry.path),
        shipped=entry.path == SHIPPED,
        kind="model" if entry.report else "agent",
        normalised=entry.normalised,
        prompt=entry.prompt,
        unusable_share=unusable.get("share"),
        marked=unusable.get("marked", False),
    )


async def _flown(request: Request, app_state: AppState, task_name: str, agent: str, run: str | None) -> Results:
    """The results of an agent over a task, one row per map, of the store or of a run."""
    flown: dict[str, Results]
    if run is None:
        flown = await run_in_threadpool(lambda: results_by_agent(app_state.store.means_by_map(task_name)))
    else:
        entries = await _entries(request, app_state, task_name, run)
        flown = {entry.agent: entry.results for entry in entries if isinstance(entry, LeaderboardEntry)}
    if agent not in flown:
        raise UnknownNameError("agent", agent, flown or ["none: nobody has flown this task"])
    results = flown[agent]
    if run is None:
        return results
    stored = await run_in_threadpool(app_state.store.stored_ids, [id_ for id_ in results.ids if id_])
    return replace(results, ids=[id_ if id_ in stored else None for id_ in results.ids])
