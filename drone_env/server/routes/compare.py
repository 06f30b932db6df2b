"""The routes that compare agents: a leaderboard, the maps of an agent, and two agents map by map."""

import sqlite3
from dataclasses import replace
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from pydantic import Field
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.core.tasks import get_task
from drone_env.errors import UnknownNameError
from drone_env.flights.provenance import HUMAN, Provenance
from drone_env.models import Count, Seed, StrictModel
from drone_env.results.folder import SHIPPED
from drone_env.results.result import Result, Results, results_by_agent
from drone_env.results.statistics import DIFFERENCES, Bounds, PairedComparison, ci95, mean_of, ranked
from drone_env.server.exceptions import error_responses
from drone_env.server.jobs import job_context
from drone_env.server.model_runs import run_name
from drone_env.server.pilots import all_pilots, display_name
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["compare"])
AgentQuery = Annotated[str, Query(max_length=200, description="The agent as in the records.")]
RunQuery = Annotated[str | None, Query(max_length=200, description="A run; without it, the flights of this server.")]
Kind = Literal["pilot", "person", "model", "other"]
Optimum = Annotated[float | None, Field(description="The highest possible score.")]


class LeaderboardRow(StrictModel):
    """One agent over the maps of a task that it flew. Means are over maps; intervals (95 %) are null for one map."""

    agent: str
    pilot: str = Field(description="The agent, or `human`.")
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
    reward: float | None = Field(description="Mean total reward; null if the reward profiles differ.")
    reward_profile: str | None = Field(description="The reward profile; null if they differ.")
    name: str = Field(description="Name for people.")
    kind: Kind = Field(description="`model`: a language model with a run in the data folder.")


class Leaderboard(StrictModel):
    """All agents of a task by mean regret, the lowest first, without forks."""

    task: str = Field(description="Id of the task.")
    rows: list[LeaderboardRow]
    forks: Count = Field(description="Number of forks, which are left out.")


class MapFigures(StrictModel):
    """Means of the flights of one agent over one map."""

    id: str | None = Field(description="Id of the newest of them in the store; null without one.")
    flights: Count
    score: float = Field(ge=0, le=1)
    steps: float
    success: float = Field(ge=0, le=1, description="Fraction of flights that delivered everything.")

    @classmethod
    def of(cls, result: Result) -> Self:
        """The means of a result."""
        return cls.model_validate(result, from_attributes=True)


class AgentMap(MapFigures):
    """The means with the map."""

    seed: Seed
    optimum: Optimum


class AgentMaps(StrictModel):
    """The maps of an agent, by number."""

    task: str = Field(description="Id of the task.")
    agent: str
    maps: list[AgentMap]


class PairedMap(StrictModel):
    """One map that both agents flew."""

    seed: Seed
    optimum: Optimum
    difference: float = Field(description="Score of a - score of b.")
    a: MapFigures
    b: MapFigures


class Pairing(StrictModel):
    """Two agents over their common maps."""

    maps: Count
    difference: float | None = Field(description="Mean of score of a - score of b; null without maps.")
    ci95: Bounds = Field(description="Its 95 % interval; null for fewer than two maps.")
    wins: Count = Field(description="Maps on which a scored higher.")
    ties: Count
    losses: Count
    pairs: list[PairedMap] = Field(description="One entry per map, by number.")


@router.get("/leaderboard/{task_name}", responses=error_responses(404, 422, 503))
def leaderboard(app_state: AppStateDep, task_name: str) -> Leaderboard:
    """The agents of a task over all finished flights; flights of an agent over the same map count as their mean."""
    maps = app_state.store.means_by_map(task_name)
    flown = results_by_agent(row for row in maps if row["parent"] is None)
    by = {row["agent"]: row for row in maps}
    models = app_state.runs.models()
    return Leaderboard(
        task=get_task(task_name).id,
        rows=[
            LeaderboardRow(
                **{name: value for name, value in vars(summary).items() if name in LeaderboardRow.model_fields},
                agent=agent,
                reward_profile=flown[agent].reward_profile,
                pilot=by[agent]["pilot"],
                name=display_name(_alone(by[agent])),
                kind=_kind(by[agent]["pilot"], models),
            )
            for agent, summary in ranked(flown)
        ],
        forks=sum(row["flights"] for row in maps if row["parent"] is not None),
    )


@router.get("/leaderboard/{task_name}/maps", responses=error_responses(404, 422, 503))
async def agent_maps(
    request: Request, app_state: AppStateDep, task_name: str, agent: AgentQuery, run: RunQuery = None
) -> AgentMaps:
    """The maps of a task that an agent flew, with its results."""
    flown = await _flown(request, app_state, task_name, agent, run)
    return AgentMaps(task=get_task(task_name).id, agent=agent, maps=[AgentMap.of(row) for row in flown.rows()])


@router.get("/paired/{task_name}", responses=error_responses(404, 422, 503))
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
        pairs=[
            PairedMap(seed=a.seed, optimum=a.optimum, difference=difference, a=MapFigures.of(a), b=MapFigures.of(b))
            for difference, a, b in rows
        ],
    )


async def _flown(request: Request, app_state: AppState, task_name: str, agent: str, run: str | None) -> Results:
    """The results of an agent over a task, one row per map, of the store or of a run."""
    if run is None:
        flown = await run_in_threadpool(lambda: results_by_agent(app_state.store.means_by_map(task_name)))
    else:
        task = await run_in_threadpool(get_task, task_name)
        if run == run_name(SHIPPED):
            flown = await run_in_threadpool(app_state.runs.results, task.id, run)
        else:
            flown = await app_state.work(request, _of_run, task.id, run)
    if agent not in flown:
        raise UnknownNameError("agent", agent, flown or ["none: nobody has flown this task"])
    if run is None:
        return flown[agent]
    ids = flown[agent].ids
    stored = await run_in_threadpool(app_state.store.stored_ids, [id_ for id_ in ids if id_])
    return replace(flown[agent], ids=[id_ if id_ in stored else None for id_ in ids])


def _of_run(task: str, run: str) -> dict[str, Results]:
    return job_context().runs.results(task, run)


def _alone(row: sqlite3.Row) -> Provenance:
    """Who flew the flights of a row, which are no forks."""
    fields = {name: row[name] for name in Provenance.model_fields if name != "parent"}
    return Provenance.model_validate(fields, strict=False)


def _kind(pilot: str, models: set[str]) -> Kind:
    if pilot == HUMAN:
        return "person"
    return "pilot" if pilot in all_pilots() else "model" if pilot in models else "other"
