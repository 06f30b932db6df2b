"""The WebSocket of the page: flights that fly by themselves or by hand, and come back after a loss."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.agents import make_agent
from drone_env.agents.pathqnet import Network
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.planning.solver import ExactSolver
from drone_env.results.analysis import analyse_actions
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.api.conftest import Clock
from tests.api.live_page import Message, Page
from tests.api.networks import put_network, put_tour


def flown(task: str, seed: int, agent: str, profile: str = "tiered") -> Episode:
    episode = Episode(task, profile)
    episode.reset(seed)
    pilot = make_agent(agent, task)
    pilot.reset(seed)
    while not episode.ended:
        episode.step(pilot.act(episode.observation()))
    return episode


def names(frames: list[Message]) -> list[str]:
    return [frame["action"] for frame in frames]


def test_a_race_is_what_the_agents_fly(client: TestClient) -> None:
    pilots = ["pathqnet", "greedy", "random"]
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        flights = page.start(*pilots, task="hard", reward_profile="composite")
        assert [flight["opening"]["pilot"] for flight in flights] == pilots
        page.send("play", speed=60)
        assert page.until("playing")["playing"]
        frames = page.flight()
        assert sorted(page.ended) == [0, 1, 2]
    for number, pilot in enumerate(pilots):
        episode = flown("hard", 7, pilot, "composite")
        assert names(frames[number]) == [Action(action).name for action in episode.actions]
        last = frames[number][-1]
        assert [frame["reward"] for frame in frames[number]] == episode.rewards
        assert (last["score"], last["done"], last["efficiency"]) == (episode.score, True, episode.efficiency)
    stored = {row["agent"]: row["score"] for row in client.get("/episodes").json()["episodes"]}
    assert stored == {pilot: frames[number][-1]["score"] for number, pilot in enumerate(pilots)}


def test_tournet_and_its_search_fly_as_their_agents_do_beside_what_pathqnet_thinks(tmp_path: Path) -> None:
    weights, data = tmp_path / "weights", tmp_path / "data"
    shipped, trained = put_tour(weights / "tournet_v1.safetensors"), put_tour(data / "tournet.safetensors", 1)
    put_network(get_task("hard"), weights)
    pilots = {
        "trained-tournet": f"tournet:{trained}",
        "tournet": f"tournet:{shipped}",
        "tournet-search": f"tournet-search:{shipped}",
    }
    with TestClient(create_app(Settings(data=data, weights=weights))) as client:
        with client.websocket_connect("/live") as socket:
            page = Page(socket)
            page.start(*pilots, task="hard")
            page.send("play", speed=60)
            frames = page.flight()
        for number, agent in enumerate(pilots.values()):
            assert names(frames[number]) == [Action(action).name for action in flown("hard", 7, agent).actions]
            assert {frame["q_values"] is not None for frame in frames[number][:-1]} == {True}
        assert len({tuple(names(frames[number])) for number in range(3)}) == 3


def test_a_broken_network_grounds_its_own_pilot_alone(client: TestClient, settings: dict[str, Any]) -> None:
    (settings["data"] / "easy.safetensors").write_bytes(b"nothing")
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.send("start", task="easy", seed=7, pilots=["greedy", "trained"])
        told = page.until("error")
        assert told["code"] == "no_network"
        assert told["detail"].startswith("easy.safetensors is not an exported network")
        shipped, greedy = page.start("pathqnet", "greedy")
        assert shipped["frames"][0]["q_values"] is not None
        assert greedy["frames"][0]["q_values"] is None


def test_a_frame_shows_what_the_observation_says(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        (shown,) = page.start("human", task="medium")
        opening = shown["opening"]
        header = {"X-Session-Id": opening["session"]}
        grid = client.get("/state", headers=header).json()["grid"]
        x, y = opening["start"]
        assert grid[y][x] == 6
        grid[y][x] = opening["cells"][y][x]
        assert grid == opening["cells"]
        for direction in ("UP", "DOWN", "LEFT", "RIGHT", "WAIT", "UP"):
            page.send("fly", direction=direction)
            frame = page.until("frames")["frames"][0]["frame"]
        state = client.get("/state", headers=header).json()
        for name in ("battery", "deliveries_done", "reward_total", "score", "done", "outcome"):
            assert frame[name] == state[name]
        assert (frame["x"], frame["y"], frame["step"]) == (state["drone_x"], state["drone_y"], state["step_count"])
        assert frame["target"] == state["current_target"]
        assert frame["q_values"] is None
        assert frame["event"] == state["path_history"][-1]["event"]


def test_an_agent_is_told_its_regret_in_flight_and_a_person_after_the_end(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("random", "human")
        known = page.until("values")
        assert known["flight"] == 0
        page.send("step")
        frame = page.until("frames")["frames"][0]["frame"]
        episode = Episode("easy")
        episode.reset(7)
        solver = ExactSolver(episode)
        optimum = solver.value(episode)
        episode.step(Action[frame["action"]])
        assert frame["value"] == solver.value(episode)
        assert frame["regret"] == optimum - frame["value"]
        while not frame["done"]:
            page.send("fly", flight=1, direction="WAIT")
            frame = page.until("frames")["frames"][0]["frame"]
            assert frame["done"] or (frame["value"], frame["regret"]) == (None, None)
        values = page.until("values")
        start = Episode("easy")
        start.reset(7)
        analysis = analyse_actions(start, [Action.WAIT] * frame["step"], "human")
        assert values["flight"] == 1
        assert values["values"] == list(analysis.values)
        assert values["regrets"] == [analysis.values[0] - value for value in analysis.values]


def test_pause_speed_and_single_steps(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("greedy", task="hard")
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1
        page.send("play", speed=2)
        steps = [page.until("frames")["frames"][0]["frame"]["step"] for _ in range(3)]
        assert steps == [2, 3, 4]
        page.send("pause")
        assert page.until("playing")["playing"] is False
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 5


def test_two_pages_on_one_session_never_fly_it_astray(client: TestClient) -> None:
    with client.websocket_connect("/live") as one, client.websocket_connect("/live") as other:
        first, second = Page(one), Page(other)
        session = first.start("random", task="medium")[0]["opening"]["session"]
        second.send("attach", sessions=[session])
        second.until("flights")
        flights: list[list[Message]] = [[], []]
        for turn in range(12):
            for page, seen in ((first, flights[0]), (second, flights[1]))[:: 1 if turn % 3 else -1]:
                page.send("step")
                seen.extend(moved["frame"] for moved in page.until("frames")["frames"])
    actions = [Action(action).name for action in flown("medium", 7, "random").actions]
    for seen in flights:
        assert [frame["step"] for frame in seen] == list(range(1, len(seen) + 1))
        assert names(seen) == actions[: len(seen)]


def test_flights_that_are_given_up_free_their_places(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        first = page.start("greedy", "random")
        second = page.start("optimal")
        for shown in first:
            assert client.get("/state", headers={"X-Session-Id": shown["opening"]["session"]}).status_code == 410
        header = {"X-Session-Id": second[0]["opening"]["session"]}
        assert client.get("/state", headers=header).status_code == 200
        page.send("end")
        assert page.until("flights")["flights"] == []
        assert client.get("/state", headers=header).status_code == 410


def test_pilots_begin_at_the_moment_that_is_asked_for(client: TestClient) -> None:
    whole = [Action(action).name for action in flown("easy", 7, "greedy").actions]
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        by_itself, by_hand = page.start("greedy", "human", step=3)
        assert [frame["action"] for frame in by_itself["frames"]] == [None, *whole[:3]]
        assert len(by_hand["frames"]) == 1
        ended = page.start("greedy", step=1000)[0]["frames"]
        assert [frame["action"] for frame in ended[1:]] == whole
        assert page.until("ended")["episode"]["agent"] == "greedy"


def test_an_open_page_keeps_its_paused_flight(tmp_path: Path, clock: Clock, eventually: Callable[..., None]) -> None:
    # Looked for every 0.25 s; idle by the test's clock alone.
    app = create_app(Settings(data=tmp_path, idle_seconds=1), clock)
    with TestClient(app) as client:
        with client.websocket_connect("/live") as socket:
            session = Page(socket).start("human")[0]["opening"]["session"]
            header = {"X-Session-Id": session}
            for _ in range(3):
                clock.now += 0.9

                def is_kept() -> bool:
                    used = app.state.shared.store.read_session(session).touched_at
                    return used == pytest.approx(clock.now, abs=0.001)

                eventually(is_kept)
            assert client.get("/state", headers=header).status_code == 200
        eventually(lambda: not app.state.live.pages)
        clock.now += 1
        eventually(lambda: client.get("/state", headers=header).status_code == 410)


COUNTED = {
    "steps": (Episode, "step"),
    "resets": (Episode, "reset"),
    "looks": (Episode, "grid"),
    "passes": (Network, "__call__"),
}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each of these was called, by anybody."""
    counts: Counter[str] = Counter()

    def count(name: str, owner: type, method: str) -> None:
        called = getattr(owner, method)

        def counting(*arguments: object) -> object:
            counts[name] += 1
            return called(*arguments)

        monkeypatch.setattr(owner, method, counting)

    for name, (owner, method) in COUNTED.items():
        count(name, owner, method)
    return counts


@pytest.mark.parametrize(
    ("pilot", "once"),
    [
        ("pathqnet", {"steps", "looks", "passes"}),
        ("tournet", {"steps", "looks", "passes"}),
        ("human", {"steps", "looks"}),
    ],
)
def test_a_frame_steps_looks_and_asks_once(client: TestClient, calls: Counter[str], pilot: str, once: set[str]) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start(pilot, task="medium")
        for step in range(1, 4):
            calls.clear()
            if pilot == "human":
                page.send("fly", direction="WAIT")
            else:
                page.send("step")
            (moved,) = page.until("frames")["frames"]
            assert moved["frame"]["step"] == step
            assert (moved["frame"]["q_values"] is None) == (pilot == "human")
            assert calls == dict.fromkeys(once, 1)
