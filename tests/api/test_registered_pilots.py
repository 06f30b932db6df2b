"""Agents that plugins registered, as pilots of the page."""

import sys
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from drone_env.agents import AGENTS, GreedyAgent
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.server.pilots import all_pilots
from tests.api.live_page import open_page


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
    with open_page(client) as page:
        page.start("homebrew", "greedy")
        page.send("play", speed=60)
        frames = page.flight()
        mine, greedy = ([frame["action"] for frame in frames[flight]] for flight in (0, 1))
        assert mine == greedy
        page.send("start", task="skyline_easy", seed=7, pilots=["homebrew"])
        assert "it does not know pads" in page.socket.receive_text()


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
