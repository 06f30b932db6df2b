"""MCP, the Model Context Protocol: the tools `reset`, `fly` and `look` over JSON-RPC, as in OpenEnv's own server."""

import asyncio
from functools import lru_cache
from typing import Any, cast

from pydantic import ValidationError

from drone_env import __version__
from drone_env.errors import (
    DroneEnvError,
    InvalidValueError,
    NoSessionError,
    SessionGoneError,
    UnknownNameError,
    text_of,
)
from drone_env.llm.prompt import FOLDER, Prompt, read_prompt
from drone_env.server.openenv_session import OpenEnvSession, flown_text, full_text
from drone_env.server.schemas import ENV_NAME, MAX_ROUTE, RouteAction, SessionReset
from drone_env.server.state import AppState

SESSION_HEADER = "Mcp-Session-Id"
INVALID_REQUEST, NO_METHOD, INVALID, FAILED = -32600, -32601, -32602, -32603
SERVER_ERROR = -32000
PROTOCOLS = ("2025-11-25", "2025-06-18", "2025-03-26")
"""Versions of MCP, newest first."""
TOOLS: list[dict[str, Any]] = [
    {
        "name": "reset",
        "description": "Start a flight over a map. Returns the rules and the observation.",
        "inputSchema": SessionReset.model_json_schema(),
    },
    {
        "name": "fly",
        "description": "Fly one action or a route. Returns what happened, and where the drone is now.",
        "inputSchema": {
            "type": "object",
            "properties": {
                "route": {
                    "type": "string",
                    "description": "UP, DOWN, LEFT, RIGHT or WAIT, or several of them, such as UP UP WAIT; "
                    f"at most {MAX_ROUTE}.",
                }
            },
            "required": ["route"],
            "additionalProperties": False,
        },
    },
    {
        "name": "look",
        "description": "Returns the rules and the observation.",
        "inputSchema": {"type": "object", "properties": {}, "additionalProperties": False},
    },
]


class ToolError(Exception):
    """A call that failed; the session is as before.

    Args:
        kind: OpenEnv's type of error.
        message: The message for people.
        code: The code of JSON-RPC.
    """

    def __init__(self, kind: str, message: str, code: int = INVALID) -> None:
        super().__init__(message)
        self.kind = kind
        self.code = code


@lru_cache(maxsize=1)
def _prompt() -> Prompt:
    return read_prompt(FOLDER / "tools" / "route-1.toml")


async def call_tool(session: OpenEnvSession, name: object, arguments: object) -> dict[str, Any]:
    """Call a tool.

    Returns:
        `text` for the model, `reward` (null unless the tool is `fly`), `flown` steps, `done`, and `score`.

    Raises:
        ToolError: if the call is invalid or cannot be executed.
    """
    if name not in [tool["name"] for tool in TOOLS]:
        shown = name[:40] if isinstance(name, str) else type(name).__name__
        raise ToolError("tool_not_found", str(UnknownNameError("tool", shown, (tool["name"] for tool in TOOLS))))
    if not isinstance(arguments, dict):
        raise ToolError("invalid_args", "the arguments of a tool are an object")
    given = cast(dict[str, Any], arguments)
    reward, flown = None, 0
    try:
        if name == "reset":
            episode = await session.reset(SessionReset.model_validate(given))
        elif unknown := sorted(given.keys() ^ ({"route"} if name == "fly" else set())):
            state = "unexpected" if unknown[0] in given else "missing"
            raise InvalidValueError(f"{unknown[0][:40]}: {state}")
        elif name == "fly":
            episode, reward, flown = await session.fly(RouteAction.model_validate(given))
        else:
            episode = await session.look()
        if name == "fly":
            text = flown_text(episode, flown)
        else:
            text = await asyncio.to_thread(full_text, _prompt(), episode)
    except ValidationError as error:
        raise ToolError("invalid_args", text_of(error, lambda where: "route" if name == "fly" else where)) from None
    except (LookupError, InvalidValueError) as error:
        raise ToolError("invalid_args", str(error)) from None
    except DroneEnvError as error:
        raise ToolError("execution_error", str(error), FAILED) from None
    return {"text": text, "reward": reward, "flown": flown, "done": episode.ended, "score": episode.score}


async def step_as_tool(session: OpenEnvSession, action: dict[str, Any]) -> dict[str, Any]:
    """Return the result of a step whose action is OpenEnv's `ListToolsAction` or `CallToolAction`."""
    if action["type"] == "list_tools":
        tools = [{"input_schema" if key == "inputSchema" else key: one[key] for key in one} for one in TOOLS]
        return {"observation": {"tools": tools, "metadata": {}}, "reward": None, "done": False}
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


async def rpc(
    shared: AppState, request: Any, session: OpenEnvSession | None = None, named: str | None = None
) -> dict[str, Any]:
    """Return the JSON-RPC response to a request.

    Args:
        shared: The parts of the server.
        request: The request.
        session: The session of a connection; None over HTTP, where each request names one.
        named: The session that the header of the request names.
    """
    fields = cast(dict[str, Any], request) if isinstance(request, dict) else {}
    number, method, params = fields.get("id"), fields.get("method"), fields.get("params", {})
    answer: dict[str, Any] = {"jsonrpc": "2.0", "id": number if isinstance(number, str | int) else None}
    try:
        if fields.get("jsonrpc") != "2.0" or not isinstance(method, str):
            message = 'Invalid Request: a request has "jsonrpc": "2.0" and a method'
            raise ToolError("invalid_request", message, INVALID_REQUEST)
        if not isinstance(params, dict):
            raise ToolError("invalid_args", "params must be an object")
        return answer | {"result": await _call(shared, method, cast(dict[str, Any], params), session, named)}
    except ToolError as error:
        return answer | {"error": {"code": error.code, "message": str(error)}}


async def _call(
    shared: AppState, method: str, params: dict[str, Any], session: OpenEnvSession | None, named: str | None
) -> dict[str, Any]:
    named = params.get("session_id", named)
    if method == "initialize":
        version = params.get("protocolVersion")
        return {
            "protocolVersion": version if version in PROTOCOLS else PROTOCOLS[0],
            "capabilities": {"tools": {}},
            "serverInfo": {"name": ENV_NAME, "version": __version__},
        }
    if method == "ping":
        return {}
    if method == "tools/list":
        return {"tools": TOOLS}
    if method == "openenv/session/create":
        if session is not None:
            return {"session_id": session.episode_id}
        try:
            return {"session_id": (await asyncio.to_thread(shared.sessions.reset, None, SessionReset(), _nothing))[0]}
        except DroneEnvError as error:
            raise ToolError("execution_error", str(error), SERVER_ERROR) from None
    if method not in ("tools/call", "openenv/session/close"):
        raise ToolError("invalid_request", f"Method not found: {method[:100]}", NO_METHOD)
    if session is not None:
        if method == "tools/call":
            return _result(await call_tool(session, params.get("name"), params.get("arguments", {})))
        raise ToolError("invalid_request", "the session ends with its connection", INVALID_REQUEST)
    if not isinstance(named, str):
        raise ToolError("invalid_args", "session_id: name the session that openenv/session/create opened")
    if method == "tools/call":
        return _result(await call_tool(OpenEnvSession(shared, named), params.get("name"), params.get("arguments", {})))
    try:
        await asyncio.to_thread(shared.sessions.end, named)
    except (NoSessionError, SessionGoneError) as error:
        raise ToolError("invalid_args", f"session_id: {error}") from None
    return {"session_id": named, "closed": True}


def _nothing(*_: object) -> None:
    pass


def _result(data: dict[str, Any]) -> dict[str, Any]:
    """Return a tool's result in MCP's format, with `data` for OpenEnv's clients."""
    text = {"type": "text", "text": data["text"]}
    return {"content": [text], "structuredContent": data, "data": data, "isError": False}
