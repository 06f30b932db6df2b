"""The routes that compare: who flies best over a task, by which maps, and two agents map by map."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import Field

from drone_env.core.tasks import get_task
from drone_env.errors import UnknownNameError
from drone_env.models import Count, Message
from drone_env.results.by_map import FlownMap
from drone_env.results.comparison import AgentMap, Pairing, Standing, agent_map, paired, standings
from drone_env.server.pilots import HUMAN, PILOTS, Credit, called
from drone_env.server.problems import answers
from drone_env.server.state import Shared, SharedParts

router = APIRouter(tags=["compare"])
AgentQuery = Annotated[str, Query(max_length=200, description="As the records name it.")]


class Contender(Standing):
    """One agent on the leaderboard."""

    name: str = Field(description="What people call it.")
    kind: Literal["pilot", "person", "model", "other"] = Field(
        description="Whether it is one of the page's pilots, a person, or a language model whose run is kept here."
    )


class Leaderboard(Message):
    """All who flew a task, who lost least first. Flights that fork from another one are left out."""

    task: str = Field(description="Id of the task.")
    rows: list[Contender]
    forks: Count = Field(description="Flights that are left out, since they begin in the midst of another one.")


class AgentMaps(Message):
    """The maps of a task that an agent flew, by number."""

    task: str = Field(description="Id of the task.")
    agent: str
    maps: list[AgentMap]


@router.get("/leaderboard/{task_name}", responses=answers(404, 422, 503))
def leaderboard(shared: SharedParts, task_name: str) -> Leaderboard:
    """Who flew a task how well, over all finished flights; several of one agent over one map count as their mean."""
    flown = shared.store.by_map(task_name)
    whole = [row for row in flown if Credit.parse(row.agent).of is None]
    models = shared.runs.models()
    return Leaderboard(
        task=get_task(task_name).id,
        rows=[
            Contender(**dict(row), name=called(row.agent), kind=_kind(row.agent, models)) for row in standings(whole)
        ],
        forks=sum(row.flights for row in flown) - sum(row.flights for row in whole),
    )


@router.get("/leaderboard/{task_name}/maps", responses=answers(404, 422, 503))
def agent_maps(shared: SharedParts, task_name: str, agent: AgentQuery) -> AgentMaps:
    """The maps of a task that an agent flew."""
    rows = [agent_map(row) for row in _flown_by(shared, task_name, agent) if row.agent == agent]
    return AgentMaps(task=get_task(task_name).id, agent=agent, maps=rows)


@router.get("/paired/{task_name}", responses=answers(404, 422, 503))
def pair(shared: SharedParts, task_name: str, a: AgentQuery, b: AgentQuery) -> Pairing:
    """Two agents over the maps of a task that both flew."""
    return paired(_flown_by(shared, task_name, a, b), a, b)


def _flown_by(shared: Shared, task_name: str, *agents: str) -> list[FlownMap]:
    """All that was flown of a task, by these among others."""
    flown = shared.store.by_map(task_name)
    known = list(dict.fromkeys(row.agent for row in flown))
    for agent in agents:
        if agent not in known:
            raise UnknownNameError("agent", agent, known or ["none: nobody has flown this task"])
    return flown


def _kind(agent: str, models: set[str]) -> Literal["pilot", "person", "model", "other"]:
    if Credit.parse(agent).pilot == HUMAN:
        return "person"
    return "pilot" if agent in PILOTS else "model" if agent in models else "other"
