"""The most expensive bodies and frames of each kind, generated from the JSON Schemas of the server."""

import asyncio
import json
import time
from collections.abc import Iterator
from typing import Any, cast

from fastapi import FastAPI
from pydantic import TypeAdapter
from starlette.types import Message

from drone_env.server.json_routes import LARGE, LIMIT, SMALL
from drone_env.server.live.commands import Command
from drone_env.server.mcp import TOOLS
from drone_env.server.openenv import ALLOWED_TYPES
from drone_env.server.schemas import OpenEnvReset, RouteAction

Schema = dict[str, Any]
ITEMS = ("1", "12345", "[]", "{}", "[[]]", '""', "1e9", "NaN", '"\\ud800"')
"""Items of long lists. 12345 is wrong in most, and so long that no list has more items than the schemas allow."""


Hostile = tuple[str, bytes]
"""The name of a body or frame, and its content."""
Cost = tuple[float, str]
"""CPU seconds of the event loop for a body or frame, and its name."""


def of_routes(description: Schema) -> Iterator[tuple[str, list[Hostile]]]:
    """The bodies for each route that takes one, as `/openapi.json` describes them, by its path."""
    for path, operations in description["paths"].items():
        for operation in operations.values():
            if "requestBody" in operation:
                schema = operation["requestBody"]["content"]["application/json"]["schema"]
                yield path, list(_texts(schema, description, operation[LIMIT]))


def of_sockets() -> dict[str, list[Hostile]]:
    """The frames for each WebSocket."""
    live = TypeAdapter(Command).json_schema()
    known: dict[str, Schema] = {"reset": OpenEnvReset.model_json_schema(), "step": RouteAction.model_json_schema()}
    ws = [
        (f"{kind} {name}", content)
        for kind in ALLOWED_TYPES.split(", ")
        if kind != "close"
        for schema in [known.get(kind, {"type": "object"})]
        for name, data in _texts(schema, schema, SMALL - 40)
        for content in [b'{"type":"%s","data":%s}' % (kind.encode(), data)]
    ]
    head = {name: {"const": value} for name, value in (("jsonrpc", "2.0"), ("method", "tools/call"))}
    mcp = [
        text
        for name, (arguments, _) in TOOLS.items()
        for schema in [arguments.model_json_schema()]
        for call in [{"name": {"const": name}, "arguments": schema}]
        for params in [{"type": "object", "properties": call, "required": list(call)}]
        for request in [{"type": "object", "properties": {**head, "params": params}, "required": [*head, "params"]}]
        for text in _texts(request, schema, SMALL - 100)
    ]
    return {"/ws": ws, "/mcp": mcp, "/live": list(_texts(live, live, LARGE))}


def _texts(schema: Schema, root: Schema, limit: int) -> Iterator[Hostile]:
    """Texts of nearly `limit` bytes: some that fit no schema, and for each part of one, the worst in its place."""
    yield ("nested lists", b"[" * (limit // 2) + b"]" * (limit // 2))
    yield ("nested objects", b'{"a":' * (limit // 5))
    yield ("twice the same key", b"{" + b",".join([b'"a":[]'] * (limit // 8)) + b"}")
    yield ("digits", b"1" * limit)
    for name, text in _values(limit):
        yield (name, text.encode())
    for variant in _variants(schema, root):
        base = _example(variant, root)
        if not isinstance(base, dict):
            continue
        size = limit - 2048 - len(json.dumps(base))
        for where, items in _places(variant, root):
            for name, text in _values(size):
                yield (f"{'.'.join(where)}: {name}", _put(base, where, text).encode())
            if items is not None:
                item = json.dumps(_example(items, root))
                text = "[" + ",".join([item] * (size // (len(item) + 1))) + "]"
                yield (f"{'.'.join(where)}: list of what belongs there", _put(base, where, text).encode())


def _values(size: int) -> Iterator[tuple[str, str]]:
    for item in ITEMS:
        yield f"list of {item}", "[" + ",".join([item] * ((size - 2) // (len(item) + 1))) + "]"
    yield "many keys", "{" + ",".join(f'"{number:x}":1' for number in range(size // 10)) + "}"
    yield "long string", '"' + "a" * (size - 2) + '"'
    yield "escaped string", '"' + "\\u00e9" * ((size - 2) // 6) + '"'


def _put(base: Any, where: tuple[str, ...], text: str) -> str:
    """The JSON of a value in which a text replaces one part; lists on the way to it have one item."""
    if not where:
        return text
    key, rest = where[0], where[1:]
    if key == "[]":
        return "[" + _put(base[0] if isinstance(base, list) and base else None, rest, text) + "]"
    known = cast(dict[str, Any], base) if isinstance(base, dict) else {}
    others = {name: value for name, value in known.items() if name != key}
    put = f"{json.dumps(key)}:{_put(known.get(key), rest, text)}"
    return "{" + ",".join([*(f"{json.dumps(name)}:{json.dumps(value)}" for name, value in others.items()), put]) + "}"


def _resolved(schema: Schema, root: Schema) -> Schema:
    while "$ref" in schema:
        found: Any = root
        for part in schema["$ref"].removeprefix("#/").split("/"):
            found = found[part]
        schema = found
    return schema


def _variants(schema: Schema, root: Schema) -> list[Schema]:
    """The alternatives of a schema, without null."""
    schema = _resolved(schema, root)
    options = schema.get("anyOf") or schema.get("oneOf") or [schema]
    return [_resolved(option, root) for option in options if option.get("type") != "null"]


def _places(schema: Schema, root: Schema) -> Iterator[tuple[tuple[str, ...], Schema | None]]:
    """The way to each part of an object, and to a part that nobody knows; of a list, the schema of its items."""
    yield ("unknown",), None
    for name, part in schema.get("properties", {}).items():
        for variant in _variants(part, root):
            where: tuple[str, ...] = (name,)
            while variant.get("type") == "array":
                items = _variants(variant.get("items", {}), root)[0]
                yield where, items
                where, variant = (*where, "[]"), items
            yield where, None
            if variant.get("type") == "object":
                yield from (((*where, *rest), items) for rest, items in _places(variant, root))


def _example(schema: Schema, root: Schema) -> Any:
    """A value that fits a schema as far as types go; of an object, what it needs."""
    schema = _variants(schema, root)[0]
    for given in ("const", "default"):
        if given in schema:
            return schema[given]
    if "enum" in schema:
        return schema["enum"][0]
    kind = schema.get("type")
    if kind == "object":
        needed = schema.get("required", [])
        return {name: _example(part, root) for name, part in schema.get("properties", {}).items() if name in needed}
    if kind == "array":
        return [_example(schema.get("items", {}), root)] * schema.get("minItems", 1)
    return {"integer": 1, "number": 1.0, "boolean": True}.get(str(kind), "x")


async def costs_of_routes(app: FastAPI) -> dict[str, list[Cost]]:
    """The CPU time of the event loop for each body, by route; the application runs."""
    description = app.openapi()
    costs: dict[str, list[Cost]] = {}
    for path, bodies in of_routes(description):
        costs[path] = [await _body_cost(app, path, *body) for body in bodies]
    return costs


async def costs_of_sockets(app: FastAPI) -> dict[str, list[Cost]]:
    """The same for each frame, by WebSocket."""
    return {path: await _frame_costs(app, path, frames) for path, frames in of_sockets().items()}


async def _body_cost(app: FastAPI, path: str, name: str, content: bytes) -> Cost:
    messages = iter([{"type": "http.request", "body": content, "more_body": False}])

    async def receive() -> Message:
        return next(messages, {"type": "http.disconnect"})

    async def send(message: Message) -> None:
        if message.get("status", 0) >= 500 and message["status"] != 503:
            raise AssertionError(f"{message['status']} for {path}, {name}")

    headers = [(b"host", b"localhost"), (b"content-type", b"application/json"), (b"transfer-encoding", b"chunked")]
    began = time.thread_time()
    await app(_scope("http", path) | {"method": "POST", "headers": headers}, receive, send)
    return time.thread_time() - began, name


async def _frame_costs(app: FastAPI, path: str, frames: list[Hostile]) -> list[Cost]:
    costs: list[Cost] = []
    given = 0
    began = time.thread_time()

    async def receive() -> Message:
        nonlocal given, began
        if given:
            await asyncio.sleep(0)  # what the answer has left to other tasks of the connection
            costs.append((time.thread_time() - began, "opening" if given == 1 else frames[given - 2][0]))
        given += 1
        if given == 1:
            return {"type": "websocket.connect"}
        if given > len(frames) + 1:
            return {"type": "websocket.disconnect", "code": 1000}
        text = frames[given - 2][1].decode()
        began = time.thread_time()
        return {"type": "websocket.receive", "text": text}

    async def send(_: Message) -> None:
        pass

    await app(_scope("websocket", path) | {"headers": [(b"host", b"localhost")], "subprotocols": []}, receive, send)
    return costs


def _scope(kind: str, path: str) -> dict[str, Any]:
    addresses = {"client": ("127.0.0.1", 5000), "server": ("127.0.0.1", 8000)}
    query = {"query_string": b"", "root_path": "", "scheme": "http", "http_version": "1.1", "raw_path": path.encode()}
    return {"type": kind, "asgi": {"version": "3.0"}, "path": path, "state": {}, **addresses, **query}
