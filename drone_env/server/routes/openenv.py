"""The routes of OpenEnv's tools: metadata, schemas, the task API, MCP."""

import asyncio
from typing import Annotated, Any, cast

from fastapi import APIRouter, Body, Request, Response
from pydantic import Field
from pydantic_core import to_json

from drone_env import __version__
from drone_env.models import DroneState, StrictModel
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.json_routes import JsonRoute
from drone_env.server.mcp import SESSION_HEADER, ToolError, named_session, rpc
from drone_env.server.schemas import DESCRIPTION, ENV_NAME, RouteAction, WireObservation
from drone_env.server.state import AppStateDep, caller_address
from drone_env.server.task_api import SplitInfo, TaskApi, TaskSpec

router = APIRouter(tags=["openenv"], route_class=JsonRoute)
named = APIRouter(prefix=f"/{ENV_NAME}", route_class=JsonRoute)
BODY_ERRORS = error_responses(400, 413, 415, 422)
REFUSED: dict[int | str, dict[str, Any]] = {
    400: {"model": dict[str, Any], "description": "Not JSON, an unknown version of MCP, or no session."},
    404: {"model": dict[str, Any], "description": "The session has ended."},
}
api = TaskApi()


class SplitRequest(StrictModel):
    """A split by its name."""

    split: str = Field(max_length=100, description="Such as `easy_delivery/test`.", examples=["easy_delivery/test"])


class TaskRequest(SplitRequest):
    """One map of a split."""

    index: int = Field(description="Number of the map within the split.")


class RangeRequest(SplitRequest):
    """Maps of a split, at most 1,000."""

    start: int | None = Field(default=None, description="Index of the first map; 0 by default.")
    stop: int | None = Field(default=None, description="Index after the last map.")


@router.get("/metadata")
async def metadata() -> dict[str, str]:
    """Name, description and version of the environment."""
    return {"name": ENV_NAME, "description": DESCRIPTION, "version": __version__}


@router.get("/schema")
async def schema() -> dict[str, dict[str, Any]]:
    """JSON Schemas of the messages of `/ws`: `action`, `observation` and `state`."""
    messages = {"action": RouteAction, "observation": WireObservation, "state": DroneState}
    return {name: message.model_json_schema() for name, message in messages.items()}


# Some clients add a slash, and do not follow the redirect.
@router.post("/mcp/", include_in_schema=False)
@router.post("/mcp", response_model=dict[str, Any], responses=error_responses(413, 415, 422) | REFUSED)
async def mcp(request: Request, app_state: AppStateDep, body: Annotated[Any, Body()] = None) -> Response:
    """MCP over JSON-RPC 2.0, with the tools `reset`, `fly` and `look`.

    `initialize` opens a session and returns it as the header `Mcp-Session-Id`, `openenv/session/create` returns it as
    `session_id`. Each call names it in the same way.
    """
    message = cast(dict[str, Any], body) if isinstance(body, dict) else {}
    method, number = message.get("method"), message.get("id")
    try:
        # Some clients initialise again but still send the id of their old session.
        named = None if method == "initialize" else await named_session(app_state, request.headers)
        if method == "tools/call" and named is None and "session_id" not in (message.get("params") or ()):
            raise ToolError("invalid_args", f"{SESSION_HEADER} is missing: send the one of initialize")
    except ToolError as error:
        return _refused(error, number)
    # The server sends no requests, so responses need no answer either.
    is_response = method is None and message.keys() & {"result", "error"}
    if is_response or (isinstance(method, str) and method.startswith("notifications/")):
        return Response(status_code=202)
    answer = await rpc(app_state, body, named=named, owner=caller_address(request))
    greeted = method == "initialize" and "result" in answer
    headers = {SESSION_HEADER: answer["result"]["session_id"]} if greeted else None
    return Response(to_json(answer), media_type="application/json", headers=headers)


@router.delete("/mcp/", include_in_schema=False)
@router.delete("/mcp", status_code=204, responses=REFUSED)
async def end_mcp(request: Request, app_state: AppStateDep) -> Response:
    """End the session that the header `Mcp-Session-Id` names."""
    try:
        named = await named_session(app_state, request.headers)
        if named is None:
            raise ToolError("invalid_args", f"{SESSION_HEADER} is missing")
    except ToolError as error:
        return _refused(error, None)
    await asyncio.to_thread(app_state.sessions.end, named)
    return Response(status_code=204)


@router.api_route("/mcp", methods=["GET", "HEAD", "OPTIONS", "PATCH", "PUT", "TRACE"], include_in_schema=False)
async def no_stream() -> None:
    """Clients of MCP ask for a stream of events; 405 means that there is none."""
    raise RequestError(405, "http", "Method Not Allowed", {"Allow": "DELETE, POST"})


def _refused(error: ToolError, number: object) -> Response:
    return Response(to_json(error.answer(number)), error.status, media_type="application/json")


@router.get("/list_environments")
async def list_environments() -> list[str]:
    """The name of the environment, the prefix of the task API."""
    return [ENV_NAME]


@named.get("/splits")
async def splits() -> list[SplitInfo]:
    """All splits."""
    return api.list_splits()


@named.post("/tasks", responses=BODY_ERRORS)
def split_tasks(body: SplitRequest) -> dict[str, str | list[TaskSpec]]:
    """The first 1,000 maps of a split as `tasks`, and `env_name`."""
    return {"tasks": api.list_tasks(body.split), "env_name": ENV_NAME}


@named.post("/num_tasks", responses=BODY_ERRORS)
def num_tasks(body: SplitRequest) -> dict[str, int]:
    """The number of maps of a split as `num_tasks`."""
    return {"num_tasks": api.num_tasks(body.split)}


@named.post("/task", responses=BODY_ERRORS)
def split_task(body: TaskRequest) -> dict[str, TaskSpec]:
    """One map of a split as `task`."""
    try:
        return {"task": api.get_task(body.split, body.index)}
    except IndexError as error:
        raise RequestError(400, "index", str(error)) from None


@named.post("/task_range", responses=BODY_ERRORS)
def task_range(body: RangeRequest) -> dict[str, list[TaskSpec]]:
    """Maps start to stop (exclusive) of a split as `tasks`, at most 1,000."""
    return {"tasks": api.get_task_range(body.split, body.start, body.stop)}


router.include_router(named)
