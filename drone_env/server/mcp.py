"""MCP, the Model Context Protocol: tools over JSON-RPC, as in OpenEnv's own server."""

import asyncio
from functools import lru_cache
from typing import Annotated, Any, cast

from fastapi import APIRouter, Body, Request, Response
from pydantic import Field, ValidationError
from pydantic_core import to_json
from starlette.datastructures import Headers

from drone_env import __version__
from drone_env.errors import CapacityError, DroneEnvError, InvalidValueError, NoSessionError, text_of
from drone_env.flights.sessions import ANONYMOUS
from drone_env.llm.prompt import FOLDER, Prompt, read_prompt, stops_text
from drone_env.models import StrictModel
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.openenv_session import OpenEnvSession, flown_text, full_text
from drone_env.server.schemas import ENV_NAME, MAX_ROUTE, Route, SessionReset
from drone_env.server.state import AppState, AppStateDep, caller_address
from drone_env.server.task_api import start_episode

SESSION_HEADER, VERSION_HEADER = "Mcp-Session-Id", "MCP-Protocol-Version"
INVALID_REQUEST, NO_METHOD, INVALID, FAILED = -32600, -32601, -32602, -32603
SERVER_ERROR, NO_SESSION = -32000, -32001
"""Clients of MCP start a new session if they read `NO_SESSION` with status 404."""
PROTOCOLS = ("2025-11-25", "2025-06-18", "2025-03-26", "2024-11-05")
"""Versions of MCP, newest first."""
REFUSED: dict[int | str, dict[str, Any]] = {
    400: {"model": dict[str, Any], "description": "Not JSON, an unknown version of MCP, or no session."},
    404: {"model": dict[str, Any], "description": "The session has ended."},
}
router = APIRouter(tags=["openenv"])


class FlyArguments(StrictModel):
    """The arguments of the tool `fly`."""

    route: Route = Field(
        description=f"UP, DOWN, LEFT, RIGHT or WAIT, or several of them, such as UP UP WAIT; at most {MAX_ROUTE}."
    )


class GotoArguments(StrictModel):
    """The arguments of the tool `goto`."""

    stop: str = Field(max_length=10, description="The letter of a stop in reach.")


class LookArguments(StrictModel):
    """The tool `look` has no arguments."""


TOOLS: dict[str, tuple[type[StrictModel], str]] = {
    "reset": (SessionReset, "Start a flight over a map. Returns the rules and the observation."),
    "fly": (FlyArguments, "Fly one action or a route. Returns what happened, and where the drone is now."),
    "goto": (
        GotoArguments,
        "Fly to a parcel or a pad in reach by the cheapest way, and fill up on a pad. Returns what happened, where the "
        "drone is now, and the stops in reach from there.",
    ),
    "look": (LookArguments, "Return the rules and the observation."),
}
"""The arguments of each tool, and what it does."""


class ToolError(Exception):
    """A call that failed; the session is as before.

    Args:
        kind: OpenEnv's type of error.
        message: The message for people.
        code: The code of JSON-RPC.
        status: The HTTP status.
    """

    def __init__(self, kind: str, message: str, code: int = INVALID, status: int = 200) -> None:
        super().__init__(message)
        self.kind = kind
        self.code = code
        self.status = status


@lru_cache(maxsize=1)
def _prompt() -> Prompt:
    return read_prompt(FOLDER / "tools" / "route-2.toml")


async def call_tool(session: OpenEnvSession, name: object, arguments: object) -> dict[str, Any]:
    """Call a tool.

    Returns:
        `text` for the model, `reward` (null unless the tool is `fly` or `goto`), `flown` steps, `done`, and `score`.

    Raises:
        ToolError: if the call is invalid or cannot be executed.
    """
    if not isinstance(name, str) or name not in TOOLS:
        raise ToolError("tool_not_found", f"there is no such tool; tools: {', '.join(TOOLS)}")
    if not isinstance(arguments, dict | None):
        raise ToolError("invalid_args", "arguments must be an object")
    reward, flown = None, 0
    try:
        given = TOOLS[name][0].model_validate(arguments or {})
        if isinstance(given, FlyArguments):
            episode, reward, flown = await session.fly(given.route)
            text = flown_text(episode, flown)
        elif isinstance(given, GotoArguments):
            episode, reward, flown = await session.goto(given.stop)
            text = flown_text(episode, flown)
            if not episode.ended:
                text += "\n" + await asyncio.to_thread(stops_text, episode)
        else:
            episode = await (session.reset(given) if isinstance(given, SessionReset) else session.look())
            # Reading the prompt loads Jinja, which takes 0.1 s.
            text = await asyncio.to_thread(lambda: full_text(_prompt(), episode))
    except ValidationError as error:
        raise ToolError("invalid_args", text_of(error)) from None
    except (LookupError, InvalidValueError) as error:
        raise ToolError("invalid_args", str(error)) from None
    except DroneEnvError as error:
        raise ToolError("execution_error", str(error), FAILED) from None
    return {"text": text, "reward": reward, "flown": flown, "done": episode.ended, "score": episode.score}


async def step_as_tool(session: OpenEnvSession, action: dict[str, Any]) -> dict[str, Any]:
    """Execute OpenEnv's `ListToolsAction` or `CallToolAction` as a step, and return its result."""
    if action["type"] == "list_tools":
        return {"observation": {"tools": _listed("input_schema"), "metadata": {}}, "reward": None, "done": False}
    name = action.get("tool_name")
    observation: dict[str, Any] = {"tool_name": name if isinstance(name, str) else ""}
    observation |= {"result": None, "error": None, "metadata": {}}
    try:
        data = await call_tool(session, name, action.get("arguments", {}))
    except ToolError as error:
        observation["error"] = {"error_type": error.kind, "message": str(error)}
        return {"observation": observation, "reward": None, "done": False}
    observation["result"] = _result(data)
    return {"observation": observation, "reward": data["reward"], "done": data["done"]}


# Some clients add a slash, and do not follow the redirect.
@router.post("/mcp/", include_in_schema=False)
@router.post("/mcp", response_model=dict[str, Any], responses=error_responses(413, 415, 422) | REFUSED)
async def mcp(request: Request, app_state: AppStateDep, body: Annotated[Any, Body()] = None) -> Response:
    """MCP over JSON-RPC 2.0, with the tools `reset`, `fly`, `goto` and `look`.

    `initialize` opens a session and returns it as the header `Mcp-Session-Id`, `openenv/session/create` returns it as
    `session_id`. Each call names it in the same way.
    """
    message = cast(dict[str, Any], body) if isinstance(body, dict) else {}
    method, headers = message.get("method"), dict[str, str]()
    try:
        # Some clients initialise again but still send the id of their old session.
        named = None if method == "initialize" else await _named_session(app_state, request.headers)
        # The server sends no requests, so responses need no answer either.
        is_response = method is None and message.keys() & {"result", "error"}
        if is_response or (isinstance(method, str) and method.startswith("notifications/")):
            return Response(status_code=202)
        result = await _call(app_state, message, named, caller_address(request))
        if method == "initialize":
            headers[SESSION_HEADER] = result["session_id"]
        return _response(message, 200, headers, result=result)
    except ToolError as error:
        return _refused(message, error)


@router.delete("/mcp/", include_in_schema=False)
@router.delete("/mcp", status_code=204, responses=REFUSED)
async def end_mcp(request: Request, app_state: AppStateDep) -> Response:
    """End the session that the header `Mcp-Session-Id` names."""
    try:
        named = await _named_session(app_state, request.headers)
        if named is None:
            raise ToolError("invalid_args", f"{SESSION_HEADER} is missing", status=400)
    except ToolError as error:
        return _refused({}, error)
    await asyncio.to_thread(app_state.sessions.end, named)
    return Response(status_code=204)


@router.api_route("/mcp", methods=["GET", "HEAD", "OPTIONS", "PATCH", "PUT", "TRACE"], include_in_schema=False)
async def no_stream() -> None:
    """Clients of MCP ask for a stream of events; 405 means that there is none."""
    raise RequestError(405, "http", "Method Not Allowed", {"Allow": "DELETE, POST"})


async def _named_session(app_state: AppState, headers: Headers) -> str | None:
    """Return the session that the headers of a request name."""
    version, named = headers.get(VERSION_HEADER, PROTOCOLS[0]), headers.get(SESSION_HEADER)
    if version not in PROTOCOLS:
        # A modern code, such as -32022, would keep newer clients from falling back to `initialize`.
        message = f"{VERSION_HEADER} is one of {', '.join(PROTOCOLS)}, got {version[:100]!r}"
        raise ToolError("invalid_request", message, INVALID_REQUEST, 400)
    if named is not None:
        try:
            await asyncio.to_thread(app_state.sessions.check, named)
        except NoSessionError as error:
            raise ToolError("invalid_request", f"Session not found: {error}", NO_SESSION, 404) from None
    return named


async def _call(app_state: AppState, message: dict[str, Any], named: str | None, owner: str) -> dict[str, Any]:
    """Return the result of a JSON-RPC request.

    Args:
        app_state: The parts of the server.
        message: The request.
        named: The session that the header of the request names, as clients of MCP do.
        owner: The address of the caller.
    """
    method: object = message.get("method")
    params: object = message.get("params") or {}
    if message.get("jsonrpc") != "2.0" or not isinstance(method, str):
        reason = 'Invalid Request: a request is one object with "jsonrpc": "2.0" and a method'
        raise ToolError("invalid_request", reason, INVALID_REQUEST)
    if not isinstance(params, dict):
        raise ToolError("invalid_args", "params must be an object")
    params = cast(dict[str, Any], params)
    if method == "ping":
        return {}
    if method == "tools/list":
        return {"tools": _listed("inputSchema")}
    try:
        if method in ("initialize", "openenv/session/create"):
            episode = start_episode(SessionReset(), None)
            opened = {"session_id": await asyncio.to_thread(app_state.sessions.open, episode, ANONYMOUS, owner=owner)}
            return opened | (_greeting(params.get("protocolVersion")) if method == "initialize" else {})
        if method not in ("tools/call", "openenv/session/close"):
            raise ToolError("invalid_request", f"Method not found: {method[:100]}", NO_METHOD)
        session_id = params.get("session_id", named)
        if not isinstance(session_id, str):
            reason = f"name a session: the {SESSION_HEADER} of initialize, or the session_id of openenv/session/create"
            raise ToolError("invalid_args", reason, status=400)
        if method == "openenv/session/close":
            await asyncio.to_thread(app_state.sessions.end, session_id)
            return {"session_id": session_id, "closed": True}
        session = OpenEnvSession(app_state, session_id)
        try:
            return _result(await call_tool(session, params.get("name"), params.get("arguments")))
        except ToolError as error:
            # MCP shows a failed call to the model. OpenEnv's clients read no `isError`, and need an exception.
            if "session_id" in params or error.kind == "tool_not_found":
                raise
            return {"content": [{"type": "text", "text": str(error)}], "isError": True}
    except CapacityError as error:
        raise ToolError("execution_error", str(error), SERVER_ERROR) from None
    except (LookupError, InvalidValueError) as error:
        raise ToolError("invalid_args", str(error)) from None


def _refused(message: dict[str, Any], error: ToolError) -> Response:
    return _response(message, error.status, {}, error={"code": error.code, "message": str(error)})


def _response(message: dict[str, Any], status: int, headers: dict[str, str], **answer: dict[str, Any]) -> Response:
    number = message.get("id")
    content = {"jsonrpc": "2.0", "id": number if isinstance(number, str | int) else None, **answer}
    return Response(to_json(content), status, headers, "application/json")


def _greeting(version: object) -> dict[str, Any]:
    return {
        "protocolVersion": version if version in PROTOCOLS else PROTOCOLS[0],
        "capabilities": {"tools": {}},
        "serverInfo": {"name": ENV_NAME, "version": __version__},
    }


def _listed(schema: str) -> list[dict[str, Any]]:
    return [
        {"name": name, "description": about, schema: arguments.model_json_schema()}
        for name, (arguments, about) in TOOLS.items()
    ]


def _result(data: dict[str, Any]) -> dict[str, Any]:
    """Return a tool's result in MCP's format, with `data` for OpenEnv's clients."""
    text = {"type": "text", "text": data["text"]}
    return {"content": [text], "structuredContent": data, "data": data, "isError": False}
