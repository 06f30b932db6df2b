"""OpenEnv's stock clients, and others that know nothing of us, fly by tools and by text."""

import asyncio
from typing import Any

import pytest

from drone_env.core.actions import Action
from drone_env.planning.optimal import solve
from tests.api.serving import Server

TOOLS = ["reset", "fly", "goto", "look"]


def best_route(task: str, seed: int) -> str:
    return " ".join(Action(action).name for action in solve(task, seed).actions)


def test_the_tool_client_flies_a_map(server: Server) -> None:
    from openenv.core.env_server.mcp_types import CallToolAction
    from openenv.core.mcp_client import MCPToolClient

    with MCPToolClient(server.url).sync() as env:
        assert [tool.name for tool in env.list_tools()] == TOOLS
        assert env.reset(task_name="hard", seed=7).metadata == {"reward_profile": "score"}
        seen = env.call_tool("look")
        assert "Score at the end: 0.8 * delivered / 5" in seen["text"]
        first, rest = (route.strip() for route in best_route("hard", 7).split("UP", 1))
        assert env.call_tool("fly", route=f"{first} UP")["reward"] == 0
        result = env.step(CallToolAction(tool_name="fly", arguments={"route": rest}))
        assert (result.reward, result.done) == (solve("hard", 7).score, True)
        assert env.call_tool("fly", route="UP")["flown"] == 0
        env.reset(task_name="hard", seed=7)
        assert "\nA parcel cost" in env.call_tool("look")["text"]
        arrived = env.call_tool("goto", stop="A")
        assert "Delivered: 1 of 5." in arrived["text"]
        assert "\nB parcel cost" in arrived["text"]
        with pytest.raises(RuntimeError, match="'A' is no stop in reach: "):
            env.call_tool("goto", stop="A")
        assert "10 x 10" in env.call_tool("reset", task_name="easy", seed=7)["text"]
        assert env.state().step_count == 0
        with pytest.raises(RuntimeError, match="route: 'SIDEWAYS' is not an action"):
            env.call_tool("fly", route="SIDEWAYS")


def test_a_client_that_knows_nothing_of_us_flies_in_each_form(server: Server) -> None:
    from openenv.core.generic_client import GenericEnvClient

    # The loop of verifiers' taskset fills the one field that the schema requires.
    (field,) = server.client.get("/schema").json()["action"]["required"]
    best = solve("easy", 7).score
    tool = {"type": "call_tool", "tool_name": "fly", "arguments": {"route": best_route("easy", 7)}, "metadata": {}}
    with GenericEnvClient(server.url).sync() as env:
        for step in ({field: best_route("easy", 7)}, tool):
            env.reset(task_name="easy", seed=7, prompt="minimal")
            result = env.step(step)
            assert (result.reward, result.done) == (best, True)
        env.reset(split="hard_delivery/test", index=3)
        assert [tool["name"] for tool in env.step({"type": "list_tools"}).observation["tools"]] == TOOLS
        with pytest.raises(RuntimeError, match="VALIDATION_ERROR"):
            env.step({"direction": "SIDEWAYS"})
        assert env.step({"direction": "UP", "metadata": {"thought": "up"}}).observation["step_count"] == 1


def test_a_client_of_mcp_flies_a_map(server: Server) -> None:
    from fastmcp import Client

    async def fly() -> Any:
        async with Client(f"{server.url}/mcp") as client:
            await client.call_tool("reset", {"task_name": "easy", "seed": 7})
            return (await client.call_tool("fly", {"route": best_route("easy", 7)})).data

    assert asyncio.run(fly())["score"] == solve("easy", 7).score
