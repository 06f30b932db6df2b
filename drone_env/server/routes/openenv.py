"""The routes of OpenEnv's tools: metadata, schemas, the task API."""

from typing import Annotated, Any

from fastapi import APIRouter, Body, Request

from drone_env import __version__
from drone_env.models import DroneState
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.schemas import DESCRIPTION, ENV_NAME, RouteAction, WireObservation
from drone_env.server.state import AppStateDep
from drone_env.server.task_api import SplitInfo, TaskApi, TaskSpec, task_in

router = APIRouter(tags=["openenv"])
named = APIRouter(prefix=f"/{ENV_NAME}")
BODY_ERRORS = error_responses(400, 413, 415, 422, 503)
api = TaskApi()


Split = Annotated[
    str,
    Body(embed=True, max_length=100, description="Such as `easy_delivery/test`.", examples=["easy_delivery/test"]),
]


@router.get("/metadata")
async def metadata() -> dict[str, str]:
    """Name, description and version of the environment."""
    return {"name": ENV_NAME, "description": DESCRIPTION, "version": __version__}


@router.get("/schema")
async def schema() -> dict[str, dict[str, Any]]:
    """JSON Schemas of the messages of `/ws`: `action`, `observation` and `state`."""
    messages = {"action": RouteAction, "observation": WireObservation, "state": DroneState}
    return {name: message.model_json_schema() for name, message in messages.items()}


@router.get("/list_environments")
async def list_environments() -> list[str]:
    """The name of the environment, the prefix of the task API."""
    return [ENV_NAME]


@named.get("/splits")
async def splits() -> list[SplitInfo]:
    """All splits."""
    return api.list_splits()


@named.post("/tasks", responses=BODY_ERRORS)
async def split_tasks(request: Request, app_state: AppStateDep, split: Split) -> dict[str, str | list[TaskSpec]]:
    """The first 1,000 maps of a split as `tasks`, and `env_name`."""
    # Difficulties take Numba, which this process does without.
    tasks = await app_state.work(request, api.list_tasks, split, task=task_in(split))
    return {"tasks": tasks, "env_name": ENV_NAME}


@named.post("/num_tasks", responses=BODY_ERRORS)
def num_tasks(split: Split) -> dict[str, int]:
    """The number of maps of a split as `num_tasks`."""
    return {"num_tasks": api.num_tasks(split)}


@named.post("/task", responses=BODY_ERRORS)
async def split_task(
    request: Request, app_state: AppStateDep, split: Split, index: Annotated[int, Body(strict=True)]
) -> dict[str, TaskSpec]:
    """One map of a split as `task`."""
    return {"task": await app_state.work(request, _task, split, index, task=task_in(split))}


@named.post("/task_range", responses=BODY_ERRORS)
async def task_range(
    request: Request,
    app_state: AppStateDep,
    split: Split,
    start: Annotated[int | None, Body(strict=True)] = None,
    stop: Annotated[int | None, Body(strict=True)] = None,
) -> dict[str, list[TaskSpec]]:
    """Maps start to stop (exclusive) of a split as `tasks`, at most 1,000; by default the first."""
    return {"tasks": await app_state.work(request, api.get_task_range, split, start, stop, task=task_in(split))}


def _task(split: str, index: int) -> TaskSpec:
    try:
        return api.get_task(split, index)
    except IndexError as error:
        raise RequestError(400, "index", str(error)) from None


router.include_router(named)
