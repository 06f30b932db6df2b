"""The most expensive bodies and frames of each kind, made from the JSON Schemas of what the server takes.

Their work is counted in validation errors, each of which costs as much as 500 bytes to parse.
"""

import json
from collections.abc import Iterator
from typing import Any, cast

import pytest
from pydantic import TypeAdapter, ValidationError
from starlette.testclient import TestClient

from drone_env import errors
from drone_env.server.incoming import LARGE, LIMIT, SMALL
from drone_env.server.live.commands import Command
from drone_env.server.openenv import ALLOWED_TYPES
from drone_env.server.schemas import ResetOptions, WireAction

Schema = dict[str, Any]
Case = tuple[str, bytes]
"""What a body or frame is, and its bytes."""
ITEMS = ("12345", '"\\ud800"')
"""Items of long lists. 12345 is wrong in most, and so long that no list has more items than the schemas allow."""


def of_routes(description: Schema) -> Iterator[tuple[str, list[Case]]]:
    """The bodies for each route that takes one, as `/openapi.json` describes them, by its path."""
    for path, operations in description["paths"].items():
        for operation in operations.values():
            if "requestBody" in operation:
                schema = operation["requestBody"]["content"]["application/json"]["schema"]
                yield path, list(_texts(schema, description, operation[LIMIT]))


def of_sockets() -> dict[str, list[Case]]:
    """The frames for each WebSocket."""
    live = TypeAdapter(Command).json_schema()
    known: dict[str, Schema] = {"reset": ResetOptions.model_json_schema(), "step": WireAction.model_json_schema()}
    ws = [
        (f"{kind} {name}", content)
        for kind in ALLOWED_TYPES.split(", ")
        if kind != "close"
        for schema in [known.get(kind, {"type": "object"})]
        for name, data in _texts(schema, schema, SMALL - 40)
        for content in [b'{"type":"%s","data":%s}' % (kind.encode(), data)]
    ]
    return {"/ws": ws, "/live": list(_texts(live, live, LARGE))}


def _texts(schema: Schema, root: Schema, limit: int) -> Iterator[Case]:
    """Texts of nearly `limit` bytes: the worst values in the place of all, and of each part of the schema."""
    for name, text in _values(limit):
        yield name, text.encode()
    for variant in _variants(schema, root):
        base = _example(variant, root)
        if not isinstance(base, dict):
            continue
        size = limit - 2048 - len(json.dumps(base))
        for where in _places(variant, root):
            for name, text in _values(size):
                yield f"{'.'.join(where)}: {name}", _put(base, where, text).encode()


def _values(size: int) -> Iterator[tuple[str, str]]:
    for item in ITEMS:
        yield f"list of {item}", "[" + ",".join([item] * ((size - 2) // (len(item) + 1))) + "]"
    yield "many keys", "{" + ",".join(f'"{number:x}":1' for number in range(size // 10)) + "}"


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


def _places(schema: Schema, root: Schema) -> Iterator[tuple[str, ...]]:
    """The way to each part of an object, and to a part that nobody knows."""
    yield ("unknown",)
    for name, part in schema.get("properties", {}).items():
        for variant in _variants(part, root):
            where: tuple[str, ...] = (name,)
            while variant.get("type") == "array":
                yield where
                where, variant = (*where, "[]"), _variants(variant.get("items", {}), root)[0]
            yield where
            if variant.get("type") == "object":
                yield from ((*where, *rest) for rest in _places(variant, root))


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


MOST = 600


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of validation errors of each refusal."""
    numbers: list[int] = []
    original = errors.wrong_parts

    def wrong_parts(error: Any) -> Any:
        numbers.append(error.error_count() if isinstance(error, ValidationError) else len(error.errors()))
        return original(error)

    monkeypatch.setattr(errors, "wrong_parts", wrong_parts)
    return numbers


def test_no_body_has_many_validation_errors(shared_client: TestClient, counted: list[int]) -> None:
    headers = {"Content-Type": "application/json"}
    for path, bodies in of_routes(shared_client.get("/openapi.json").json()):
        for name, content in bodies:
            answer = shared_client.post(path.replace("{env_name}", "drone-env"), content=content, headers=headers)
            assert answer.status_code < 500, (path, name, answer.text)
    assert 0 < max(counted) <= MOST


@pytest.mark.parametrize("path", ["/ws", "/live"])
def test_no_frame_has_many_validation_errors(shared_client: TestClient, counted: list[int], path: str) -> None:
    with shared_client.websocket_connect(path) as socket:
        for name, content in of_sockets()[path]:
            socket.send_text(content.decode())
            answer = json.loads(socket.receive_text())
            assert answer["type"] in ("error", "observation", "state", "mcp"), (name, answer)
            assert "the server failed" not in str(answer), name
    assert 0 < max(counted) <= MOST
