"""The routes that list tasks, graders, cell kinds and pilots, and the health check."""

from fastapi import APIRouter

from drone_env import __version__
from drone_env.core.cells import CELL_KINDS
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import StoreError
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.live.commands import MOST_EPISODES
from drone_env.server.pilots import COLOURS, HUMAN, all_pilots, can_fly
from drone_env.server.predict import SOURCES
from drone_env.server.schemas import (
    GraderInfo,
    GraderList,
    Health,
    KindInfo,
    KindList,
    OneTask,
    PilotInfo,
    PilotList,
    ProfileInfo,
    TaskInfo,
    TaskList,
)
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["catalogue"])
PUBLISHED = ("easy_delivery", "medium_delivery", "hard_delivery")
"""The tasks of `openenv.yaml`."""


@router.get("/tasks")
async def tasks() -> TaskList:
    """All tasks with all their numbers, and the reward profiles."""
    return TaskList(
        tasks=[TaskInfo.of(task, task.id in PUBLISHED) for task in TASKS.values()],
        reward_profiles=[ProfileInfo.of(profile) for profile in REWARD_PROFILES.values()],
    )


@router.get("/tasks/{task_name}", responses=error_responses(404, 422))
def one_task(shared: AppStateDep, task_name: str) -> OneTask:
    """One task with all its numbers, and its pilots. Stored drawings are found by name; `/tasks` does not list them."""
    return describe(get_task(task_name), shared)


def describe(task: TaskConfig, shared: AppState) -> OneTask:
    """A task and its pilots."""
    flying = [name for name in all_pilots() if can_fly(name, task, shared.networks)]
    return OneTask(task=TaskInfo.of(task, task.id in PUBLISHED), pilots=flying)


@router.get("/graders")
async def graders() -> GraderList:
    """The graders: functions with these import paths."""
    found = [GraderInfo(id=task.grader, task=task.id) for task in TASKS.values()]
    return GraderList(graders=found, ids=[grader.id for grader in found])


@router.get("/kinds")
async def kinds() -> KindList:
    """The kinds of cells."""
    return KindList(kinds=[KindInfo(id=cell, **kind._asdict()) for cell, kind in CELL_KINDS.items()])


@router.get("/pilots")
def pilots(shared: AppStateDep) -> PilotList:
    """The pilots of the page and their tasks; networks that you trained are included."""
    pilots: list[PilotInfo] = []
    for colour, (name, pilot) in enumerate(all_pilots().items(), 1):
        tasks = [task.id for task in TASKS.values() if can_fly(name, task, shared.networks)]
        if tasks or name not in SOURCES or not SOURCES[name].trained:
            look, automatic = min(colour, COLOURS), name != HUMAN
            pilots.append(PilotInfo(id=name, **pilot._asdict(), colour=look, automatic=automatic, tasks=tasks))
    return PilotList(pilots=pilots, most=MOST_EPISODES)


@router.head("/health", include_in_schema=False)
@router.get("/health", responses=error_responses(503))
async def health(shared: AppStateDep) -> Health:
    """Whether the server works and its files are in place; requires no token."""
    try:
        shared.store.check()
    except StoreError:
        # The error itself would reveal the folder.
        why = "files of the data folder were deleted, moved or replaced while in use: nothing more is stored"
        raise RequestError(503, "store", f"{why} until they are back or the server restarts") from None
    return Health(version=__version__)
