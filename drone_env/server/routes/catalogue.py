"""The routes that list tasks, graders, cell kinds and pilots, and the health check."""

from dataclasses import fields
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter
from pydantic import Field, create_model
from typing_extensions import Self

from drone_env import __version__
from drone_env.core.actions import Event
from drone_env.core.cells import CELL_KINDS
from drone_env.core.rewards import REWARD_PROFILES, RewardProfile, tabulate_rewards
from drone_env.core.rules import HIGHEST, LOWEST
from drone_env.core.tasks import TASKS, TERRAIN, TaskConfig, get_task
from drone_env.core.terrain import Name, Terrain
from drone_env.flights.provenance import HUMAN
from drone_env.models import Count, Score, StrictModel
from drone_env.server.exceptions import error_responses
from drone_env.server.pilots import COLOURS, all_pilots
from drone_env.server.routes.flights import MOST_FLIGHTS
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["catalogue"])
STAYING = (Event.WALL, Event.BLOCKED, Event.WAIT)
"""Events that do not change the distance to the target."""


_CONVERTED = ("buildings", "trees", "obstacles", "drain", "impassable", "terrain")
CellCount = Annotated[int | None, Field(description="Number of such cells; null if maps differ: windows of a city.")]
_PLAIN: dict[str, Any] = {n.name: (n.type, ...) for n in fields(TaskConfig) if n.name not in _CONVERTED}


SCORE_WEIGHTS = {"parcels": 80, "battery": 10, "steps": 10}
"""The weights in `score_of`, equal for all tasks."""


class TaskInfo(create_model("TaskNumbers", __base__=StrictModel, **_PLAIN)):
    """One task: the fields of its `TaskConfig`, except for the terrain."""

    name: str = Field(description="Same as `id`.")
    buildings: CellCount
    trees: CellCount
    obstacles: CellCount
    drain: dict[str, int] = Field(description="Battery units of a step by kind of cell below the drone.")
    impassable: list[str] = Field(description="Kinds of cells that the drone cannot enter.")
    charge_rate: int = Field(description="Battery units that waiting on a pad adds.")
    rewards: dict[str, dict[str, list[float]]] = Field(
        description="Reward of each event, by reward profile; empty if the profile does not reward events. Three "
        "numbers if the drone moves: distance to the target grows, stays equal, shrinks. Otherwise one number."
    )
    score_weights: dict[str, int] = Field(description="Points, of 100, for all parcels, a full battery and no step.")
    score_range: tuple[Score, Score] = Field(description="The lowest and the highest score.")
    attribution: str = Field(description="Attribution of its terrain data, to be shown with it; empty for none.")
    cell: float | None = Field(description="Metres along the side of a cell; null if unknown.")
    names: list[Name] = Field(
        description="Names on its maps: text, x and y in cells; of a street its degrees clockwise."
    )

    @classmethod
    def of(cls, task: TaskConfig) -> Self:
        """Describe a task."""
        terrain = task.terrain or Terrain(b"", task.width)
        sizes = None if task.terrain is None else (terrain.width, terrain.height)
        same = sizes in (None, (task.width, task.height))
        return cls(
            **{name: getattr(task, name) for name in _PLAIN},
            name=task.id,
            buildings=task.buildings if same else None,
            trees=task.trees if same else None,
            obstacles=task.obstacles if same else None,
            drain={CELL_KINDS[cell].name: n for cell, n in (dict.fromkeys(TERRAIN, 1) | dict(task.drain)).items()},
            impassable=sorted(CELL_KINDS[cell].name for cell in task.impassable),
            rewards={profile.id: _event_rewards(task, profile) for profile in REWARD_PROFILES.values()},
            score_weights=SCORE_WEIGHTS,
            score_range=(LOWEST, HIGHEST),
            attribution=task.attribution,
            cell=terrain.cell,
            names=[*terrain.names] if same else [],
        )


def _event_rewards(task: TaskConfig, profile: RewardProfile) -> dict[str, list[float]]:
    table = np.reshape(np.asarray(tabulate_rewards(task, profile).events), (-1, 3))
    events = [event for event in Event if event is not Event.NONE and table.any()]
    return {event.name.lower(): (table[event, 1:2] if event in STAYING else table[event]).tolist() for event in events}


class OneTask(StrictModel):
    """One task and its pilots."""

    task: TaskInfo
    pilots: list[str] = Field(description="Ids of the pilots that can fly it, as in `/pilots`.")


class KindInfo(StrictModel):
    """One kind of cell."""

    id: Count = Field(description="Its number in grids.")
    name: str
    emoji: str
    effect: str


class PilotInfo(StrictModel):
    """One pilot of the page."""

    id: str
    name: str
    summary: str
    colour: int = Field(ge=1, description="Number of its colour on the page.")
    automatic: bool = Field(description="False for a human pilot.")
    tasks: list[str] = Field(description="Ids of the tasks that it can fly.")


class PilotList(StrictModel):
    """All pilots of the page."""

    pilots: list[PilotInfo]
    most: Count = Field(description="Most pilots in a race.")


@router.get("/tasks")
async def tasks() -> dict[str, list[TaskInfo]]:
    """All tasks with all their numbers, as `tasks`."""
    return {"tasks": [TaskInfo.of(task) for task in TASKS.values()]}


@router.get("/tasks/{task_name}", responses=error_responses(404, 422))
def one_task(app_state: AppStateDep, task_name: str) -> OneTask:
    """One task with all its numbers, and its pilots. Stored drawings are found by name; `/tasks` does not list them."""
    return describe(get_task(task_name), app_state)


def describe(task: TaskConfig, app_state: AppState) -> OneTask:
    """A task and its pilots."""
    flying = [name for name in all_pilots() if app_state.networks.flies(name, task)]
    return OneTask(task=TaskInfo.of(task), pilots=flying)


@router.get("/graders")
async def graders() -> dict[str, list[str | dict[str, str]]]:
    """The graders as `graders`: import path (`id`) and `task` of each; the paths alone as `ids`."""
    tasks = TASKS.values()
    return {"graders": [{"id": task.grader, "task": task.id} for task in tasks], "ids": [task.grader for task in tasks]}


@router.get("/kinds")
async def kinds() -> dict[str, list[KindInfo]]:
    """The kinds of cells as `kinds`."""
    return {"kinds": [KindInfo(id=cell, **kind._asdict()) for cell, kind in CELL_KINDS.items()]}


@router.get("/pilots")
def pilots(app_state: AppStateDep) -> PilotList:
    """The pilots of the page and their tasks; networks that you trained are included."""
    pilots: list[PilotInfo] = []
    for colour, (name, pilot) in enumerate(all_pilots().items(), 1):
        tasks = [task.id for task in TASKS.values() if app_state.networks.flies(name, task)]
        if tasks or not pilot.trained:
            look, automatic = min(colour, COLOURS), name != HUMAN
            about = {"name": pilot.name, "summary": pilot.summary}
            pilots.append(PilotInfo(id=name, **about, colour=look, automatic=automatic, tasks=tasks))
    return PilotList(pilots=pilots, most=MOST_FLIGHTS)


@router.head("/health", include_in_schema=False)
@router.get("/health", responses=error_responses(503))
async def health(app_state: AppStateDep) -> dict[str, str]:
    """Whether the server works and can store steps; requires no token."""
    app_state.store.check()
    return {"status": "healthy", "version": __version__}
