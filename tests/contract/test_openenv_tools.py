"""OpenEnv's stock clients, and others that know nothing of us, fly by tools and by text."""

import asyncio
import json
import re
from collections.abc import Generator
from typing import Any

import pytest
from websockets.sync.client import connect

from drone_env.core.actions import Action
from drone_env.planning.optimal import solve
from tests.api.serving import Server, serving
from tests.contract import official


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server, None, None]:
    # Requests of a session reach both processes.
    with serving(tmp_path_factory.mktemp("tools") / "data", WORKERS="2") as running:
        yield running


def best_route(task: str, seed: int) -> str:
    return " ".join(Action(action).name for action in solve(task, seed).actions)


def test_the_tool_client_flies_a_map(server: Server) -> None:
    with official.MCPToolClient(server.url).sync() as env:
        assert [tool.name for tool in env.list_tools()] == ["reset", "fly", "look"]
        assert env.reset(task_name="hard", seed=7).metadata == {"reward_profile": "score"}
        seen = env.call_tool("look")
        assert "Score at the end: 0.8 * delivered / 5" in seen["text"]
        first, rest = (route.strip() for route in best_route("hard", 7).split("UP", 1))
        assert env.call_tool("fly", route=f"{first} UP")["reward"] == 0
        result = env.step(official.CallToolAction(tool_name="fly", arguments={"route": rest}))
        assert (result.reward, result.done) == (solve("hard", 7).score, True)
        assert env.call_tool("fly", route="UP")["flown"] == 0
        assert "10 x 10" in env.call_tool("reset", task_name="easy", seed=7)["text"]
        assert env.state().step_count == 0
        with pytest.raises(RuntimeError, match="route: 'SIDEWAYS' is not an action"):
            env.call_tool("fly", route="SIDEWAYS")


def test_the_generic_client_flies_by_routes_and_by_tools(server: Server) -> None:
    with official.GenericEnvClient(server.url).sync() as env:
        env.reset(task_name="hard", seed=7, prompt="minimal")
        result = env.step({"route": best_route("hard", 7)})
        assert (result.reward, result.done, result.metadata["flown"]) == (solve("hard", 7).score, True, 46)
        env.reset(task_name="easy", seed=7)
        tools = env.step({"type": "list_tools"}).observation["tools"]
        assert [tool["name"] for tool in tools] == ["reset", "fly", "look"]
        call = {"type": "call_tool", "tool_name": "fly", "arguments": {"route": best_route("easy", 7)}, "metadata": {}}
        assert env.step(call).reward == solve("easy", 7).score


def test_a_client_of_mcp_flies_a_map(server: Server) -> None:
    async def fly() -> Any:
        async with official.McpClient(f"{server.url}/mcp") as client:
            await client.call_tool("reset", {"task_name": "easy", "seed": 7})
            return (await client.call_tool("fly", {"route": best_route("easy", 7)})).data

    assert asyncio.run(fly())["score"] == solve("easy", 7).score


def text_client(url: str) -> Any:
    """A client with the wire format of TextArena's, which the examples of TRL use."""

    class TextClient(official.GenericEnvClient):
        def _step_payload(self, action: str) -> dict[str, Any]:
            return {"message": action}

    return TextClient(url).sync()


def test_a_client_of_text_flies_where_the_url_names_task_and_prompt(server: Server) -> None:
    with text_client(f"{server.url}/hard/minimal") as env:
        result = env.reset(seed=7)
        told = result.observation["messages"][0]["content"]
        assert told == result.observation["prompt"]
        for word in best_route("hard", 7).split():
            assert not result.done
            result = env.step(f"[{word}]")
            last, told = told, result.observation["messages"][0]["content"]
            assert told.startswith(f"{last}\nFlown: 1. ")
        assert (result.reward, result.done) == (solve("hard", 7).score, True)
        again = env.step("[UP]").observation["messages"][0]["content"]
        assert again == told
    for path in ("none/minimal", "hard/none", "hard/minimal-2.toml"):
        # OpenEnv's client does not close a connection that the server has refused.
        with connect(f"{server.url.replace('http', 'ws', 1)}/{path}/ws") as socket:
            data = json.loads(socket.recv())["data"]
        assert data["code"] == "SESSION_ERROR"
        assert re.search("none|prompt", data["message"])


def test_a_client_of_numbers_flies(server: Server) -> None:
    with official.GenericEnvClient(server.url).sync() as env:
        env.reset(task_name="easy", seed=7)
        for action in solve("easy", 7).actions:
            result = env.step({"action_id": int(action), "game_name": "catch", "game_params": {}})
        assert (result.reward, result.done) == (solve("easy", 7).score, True)


def test_an_answer_that_is_no_json_fills_the_one_field_that_the_schema_requires(server: Server) -> None:
    # The loop of verifiers' taskset.
    schema = server.client.get("/schema").json()["action"]
    (field,) = schema["required"]
    with official.GenericEnvClient(server.url).sync() as env:
        env.reset(task_name="easy", seed=7, prompt="coordinates")
        result = env.step({field: best_route("easy", 7)})
    assert (result.reward, result.done) == (solve("easy", 7).score, True)
