"""The routes that compare: who flies best over a task, by which maps, and two agents map by map."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import Field
from typing_extensions import Self

from drone_env.core.tasks import get_task
from drone_env.errors import UnknownNameError
from drone_env.models import Count, Message, Seed
from drone_env.results.result import Result, Results
from drone_env.results.statistics import DIFFERENCES, Bounds, PairedComparison, Summary, ci95, mean_of, ranked
from drone_env.server.pilots import HUMAN, Provenance, all_pilots, display_name
from drone_env.server.problems import answers
from drone_env.server.state import Shared, SharedParts

router = APIRouter(tags=["compare"])
AgentQuery = Annotated[str, Query(max_length=200, description="As the records name it.")]
Kind = Literal["pilot", "person", "model", "other"]
Optimum = Annotated[float | None, Field(description="The highest score that any flight over it reaches.")]


class LeaderboardEntry(Message):
    """One agent over the maps of a task that it flew. Means are over maps; intervals (95 %) are null for one map."""

    agent: str
    flights: Count
    maps: Count = Field(description="How many different maps.")
    success_rate: float = Field(ge=0, le=1, description="Share of flights that delivered everything.")
    success_ci95: Bounds
    score: float = Field(ge=0, le=1, description="Mean graded score.")
    score_ci95: Bounds
    regret: float | None = Field(description="Mean of optimum - score, over the maps whose optimum is known.")
    regret_ci95: Bounds
    regret_maps: Count = Field(description="How many these are; the others are being solved, or too large for it.")
    steps: float = Field(description="Mean length in steps.")
    reward: float | None = Field(description="Mean total reward; null where not all flights were paid alike.")
    reward_profile: str | None = Field(description="What they were paid by; null likewise.")
    name: str = Field(description="What people call it.")
    kind: Kind = Field(description="A pilot of the page, a person, a language model whose run is kept here, or other.")


class Leaderboard(Message):
    """All who flew a task, who lost least first. Flights that fork from another one are left out."""

    task: str = Field(description="Id of the task.")
    rows: list[LeaderboardEntry]
    forks: Count = Field(description="Flights that are left out, since they begin in the midst of another one.")


class MapFigures(Message):
    """The flights of one agent over one map; figures are their means."""

    id: str | None = Field(description="The newest of them in the store; null where it has none.")
    flights: Count
    score: float = Field(ge=0, le=1)
    steps: float
    success: float = Field(ge=0, le=1, description="Share of them that delivered everything.")

    @classmethod
    def of(cls, result: Result) -> Self:
        """The figures of a map."""
        return cls.model_validate(result, from_attributes=True)


class AgentMap(MapFigures):
    """The same with the map."""

    seed: Seed
    optimum: Optimum


class AgentMaps(Message):
    """The maps of a task that an agent flew, by number."""

    task: str = Field(description="Id of the task.")
    agent: str
    maps: list[AgentMap]


class PairedMap(Message):
    """One map that both agents flew."""

    seed: Seed
    optimum: Optimum
    difference: float = Field(description="The score of a less that of b.")
    a: MapFigures
    b: MapFigures


class Pairing(Message):
    """Two agents over the maps that both flew."""

    maps: Count
    difference: float | None = Field(description="Mean over these maps of a's score less b's; null without any map.")
    ci95: Bounds = Field(description="Its interval (95 %); null for fewer than two maps.")
    wins: Count = Field(description="Maps on which a scored more.")
    ties: Count
    losses: Count
    pairs: list[PairedMap] = Field(description="Map by map, by number.")


@router.get("/leaderboard/{task_name}", responses=answers(404, 422, 503))
def leaderboard(shared: SharedParts, task_name: str) -> Leaderboard:
    """Who flew a task how well, over all finished flights; several of one agent over one map count as their mean."""
    flown = shared.store.by_map(task_name)
    forks = [Summary.of(flown.pop(agent)) for agent in list(flown) if Provenance.parse(agent).of is not None]
    models = shared.runs.models()
    return Leaderboard(
        task=get_task(task_name).id,
        rows=[
            LeaderboardEntry(
                **{name: value for name, value in vars(summary).items() if name in LeaderboardEntry.model_fields},
                agent=agent,
                reward_profile=flown[agent].reward_profile,
                name=display_name(agent),
                kind=_kind(agent, models),
            )
            for agent, summary in ranked(flown)
        ],
        forks=sum(fork.flights for fork in forks),
    )


@router.get("/leaderboard/{task_name}/maps", responses=answers(404, 422, 503))
def agent_maps(shared: SharedParts, task_name: str, agent: AgentQuery) -> AgentMaps:
    """The maps of a task that an agent flew."""
    (flown,) = _flown_by(shared, task_name, agent)
    return AgentMaps(task=get_task(task_name).id, agent=agent, maps=[AgentMap.of(row) for row in flown.rows()])


@router.get("/paired/{task_name}", responses=answers(404, 422, 503))
def pair(shared: SharedParts, task_name: str, a: AgentQuery, b: AgentQuery) -> Pairing:
    """Two agents over the maps of a task that both flew."""
    paired = PairedComparison.of(*_flown_by(shared, task_name, a, b))
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


def _flown_by(shared: Shared, task_name: str, *agents: str) -> list[Results]:
    """The results of agents over a task, one row per map."""
    flown = shared.store.by_map(task_name)
    for agent in agents:
        if agent not in flown:
            raise UnknownNameError("agent", agent, flown or ["none: nobody has flown this task"])
    return [flown[agent] for agent in agents]


def _kind(agent: str, models: set[str]) -> Kind:
    if Provenance.parse(agent).pilot == HUMAN:
        return "person"
    return "pilot" if agent in all_pilots() else "model" if agent in models else "other"
