"""The routes that OpenEnv's tools look for: metadata, schemas, the task API, MCP."""

from typing import Annotated, Any

from fastapi import APIRouter, Body, Path
from pydantic import Field

from drone_env import __version__
from drone_env.models import DroneState, Message
from drone_env.server.openenv import task_api
from drone_env.server.openenv.session import DESCRIPTION, ENV_NAME
from drone_env.server.openenv.socket import mcp_answer
from drone_env.server.problems import RequestError, answers
from drone_env.server.schemas import WireAction, WireObservation

router = APIRouter(tags=["openenv"])
EnvName = Annotated[str, Path(description="Name of the environment.", examples=[ENV_NAME])]
BODY_ERRORS = answers(400, 404, 413, 415, 422)


class Metadata(Message):
    """What the environment is."""

    name: str
    description: str
    version: str
    readme_content: str | None = None
    author: str | None = None
    documentation_url: str | None = None


class Schemas(Message):
    """JSON Schemas of what travels over `/ws`."""

    action: dict[str, Any]
    observation: dict[str, Any]
    reset_observation: dict[str, Any]
    state: dict[str, Any]


class SplitInfo(Message):
    """A split."""

    name: str
    type: str


class TaskSpec(Message):
    """One map of a split."""

    id: str
    index: int
    split: str
    task_name: str
    seed: int


class SplitRequest(Message):
    """A split by its name."""

    split: str = Field(max_length=100, description="Such as `easy_delivery/test`.", examples=["easy_delivery/test"])


class TaskRequest(SplitRequest):
    """One map of a split."""

    index: int = Field(description="Number of the map within the split.")


class RangeRequest(SplitRequest):
    """Maps of a split, at most 1,000."""

    start: int | None = Field(default=None, description="The first; 0 without one.")
    stop: int | None = Field(default=None, description="The one after the last.")


class TaskSpecs(Message):
    """Maps of a split."""

    tasks: list[TaskSpec]


class NamedTaskSpecs(TaskSpecs):
    """Maps of a split, and the environment's name."""

    env_name: str = ENV_NAME


class TaskCount(Message):
    """How many maps a split has."""

    num_tasks: int


class OneTask(Message):
    """One map."""

    task: TaskSpec


@router.get("/metadata")
async def metadata() -> Metadata:
    """What the environment is."""
    return Metadata(name=ENV_NAME, description=DESCRIPTION, version=__version__)


@router.get("/schema")
async def schema() -> Schemas:
    """JSON Schemas of what travels over `/ws`."""
    observation = WireObservation.model_json_schema()
    return Schemas(
        action=WireAction.model_json_schema(),
        observation=observation,
        reset_observation=observation,
        state=DroneState.model_json_schema(),
    )


@router.post("/mcp", responses=answers(400, 413, 415, 422))
async def mcp(body: Annotated[Any, Body()] = None) -> dict[str, Any]:
    """MCP over JSON-RPC 2.0. The environment has no tools: it is flown by `/step` or over `/ws`."""
    return mcp_answer(body)


@router.get("/list_environments")
async def list_environments() -> list[str]:
    """The name under which the task API is found."""
    return [ENV_NAME]


@router.get("/{env_name}/splits", responses=answers(404, 422))
async def splits(env_name: EnvName) -> list[SplitInfo]:
    """All splits."""
    _check(env_name)
    return [SplitInfo.model_validate(split) for split in task_api.list_splits()]


@router.post("/{env_name}/tasks", responses=BODY_ERRORS)
def split_tasks(env_name: EnvName, body: SplitRequest) -> NamedTaskSpecs:
    """The first 1,000 maps of a split."""
    _check(env_name)
    return NamedTaskSpecs(tasks=_specs(task_api.list_tasks(body.split)))


@router.post("/{env_name}/num_tasks", responses=BODY_ERRORS)
async def num_tasks(env_name: EnvName, body: SplitRequest) -> TaskCount:
    """How many maps a split has."""
    _check(env_name)
    return TaskCount(num_tasks=task_api.num_tasks(body.split))


@router.post("/{env_name}/task", responses=BODY_ERRORS)
async def split_task(env_name: EnvName, body: TaskRequest) -> OneTask:
    """One map of a split."""
    _check(env_name)
    try:
        return OneTask(task=TaskSpec.model_validate(task_api.describe(body.split, body.index)))
    except IndexError as error:
        raise RequestError(400, "index", str(error)) from None


@router.post("/{env_name}/task_range", responses=BODY_ERRORS)
def task_range(env_name: EnvName, body: RangeRequest) -> TaskSpecs:
    """Maps start to stop (exclusive) of a split, at most 1,000."""
    _check(env_name)
    return TaskSpecs(tasks=_specs(task_api.get_task_range(body.split, body.start, body.stop)))


def _check(env_name: str) -> None:
    if env_name.lower() != ENV_NAME:
        raise RequestError(404, "unknown_name", f"unknown environment {env_name!r}; there is {ENV_NAME!r}")


def _specs(tasks: list[dict[str, Any]]) -> list[TaskSpec]:
    return [TaskSpec.model_validate(task) for task in tasks]
