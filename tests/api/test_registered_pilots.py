"""Agents that plugins registered, as pilots of the page."""

import sys
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from drone_env.agents import AGENTS, GreedyAgent
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.server.pilots import all_pilots
from tests.api.flying import start


@pytest.fixture
def homebrew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("DRONE_ENV_PLUGINS", "tests.api.homebrew")
    yield
    del AGENTS["homebrew"], sys.modules["tests.api.homebrew"]


@pytest.mark.usefixtures("homebrew")
def test_a_registered_agent_flies_on_the_page(client: TestClient) -> None:
    *_, last = client.get("/pilots").json()["pilots"]
    assert last == {
        "id": "homebrew",
        "name": "homebrew",
        "summary": "Flies as I think it should.",
        "colour": len(all_pilots()),
        "automatic": True,
        "tasks": [task.id for task in TASKS.values() if not task.pads],
    }
    mine, greedy = ([frame["action"] for frame in shown["frames"]] for shown in start(client, "homebrew", "greedy"))
    assert mine == greedy
    refused = client.post("/flights", json={"task": "skyline_easy", "pilots": ["homebrew"]})
    assert "it does not know pads" in refused.json()["detail"]


@pytest.mark.usefixtures("homebrew")
def test_one_that_cannot_be_made_takes_no_other_pilot_away(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(task: TaskConfig) -> GreedyAgent:
        raise KeyError(task.id)

    monkeypatch.setitem(AGENTS, "broken", broken)
    pilots = {pilot["id"]: pilot for pilot in client.get("/pilots").json()["pilots"]}
    assert pilots["broken"]["tasks"] == []
    assert pilots["broken"]["summary"] == "An agent that a plugin of this server registered."
    assert pilots["homebrew"]["tasks"]
    assert "a registered agent is no pilot on easy_delivery" in caplog.text
