"""The WebSocket of the page: flights that fly by themselves or by hand, and come back after a loss."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.flights.store import FILE_NAME
from drone_env.planning.solver import ExactSolver
from drone_env.results.analysis import analyse_actions
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.api.conftest import Clock
from tests.api.live_page import Message, Page, directions, flown, open_page
from tests.api.networks import put_network, put_tour
from tests.tools import eventually


def names(frames: list[Message]) -> list[str]:
    return [frame["action"] for frame in frames]


def test_a_race_is_what_the_agents_fly_beside_what_pathqnet_thinks(tmp_path: Path) -> None:
    weights, data = tmp_path / "weights", tmp_path / "data"
    shipped, trained = put_tour(weights / "tournet_v1.safetensors"), put_tour(data / "tournet.safetensors", 1)
    pilots = {
        "trained-tournet": f"tournet:{trained}",
        "tournet": f"tournet:{shipped}",
        "pathqnet": f"pathqnet:{put_network(get_task('hard'), weights)}",
    }
    with TestClient(create_app(Settings(data=data, weights=weights))) as client:
        with open_page(client) as page:
            flights = page.start(*pilots, task="hard", reward_profile="composite")
            assert [flight["opening"]["pilot"] for flight in flights] == [*pilots]
            page.send("play", speed=60)
            assert page.until("playing")["playing"]
            frames = page.flight()
            assert sorted(page.ended) == [0, 1, 2]
        stored = {row["agent"]: row["score"] for row in client.get("/episodes").json()["episodes"]}
    for number, (pilot, agent) in enumerate(pilots.items()):
        episode = flown("hard", agent, profile="composite")
        assert names(frames[number]) == directions(episode)
        assert [frame["reward"] for frame in frames[number]] == episode.rewards
        assert {frame["q_values"] is not None for frame in frames[number][:-1]} == {True}
        last = frames[number][-1]
        assert (last["score"], last["done"], last["efficiency"]) == (episode.score, True, episode.efficiency)
        assert stored[pilot] == last["score"]
    assert len({tuple(names(frames[number])) for number in range(2)}) == 2


def test_a_broken_network_grounds_its_own_pilot_alone(client: TestClient, settings: dict[str, Any]) -> None:
    (settings["data"] / "easy.safetensors").write_bytes(b"nothing")
    with open_page(client) as page:
        page.send("start", task="easy", seed=7, pilots=["greedy", "trained"])
        told = page.until("error")
        assert told["code"] == "no_network"
        assert told["detail"].startswith("easy.safetensors is not an exported network")
        shipped, greedy = page.start("pathqnet", "greedy")
        assert shipped["frames"][0]["q_values"] is not None
        assert greedy["frames"][0]["q_values"] is None


def test_a_frame_shows_what_the_observation_says(client: TestClient) -> None:
    with open_page(client) as page:
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
    with open_page(client) as page:
        page.start("random", "human")
        known = page.until("values")
        assert known["flight"] == 0
        page.send("step")
        frame = page.until("frames")["frames"][0]["frame"]
        episode = Episode("easy", seed=7)
        solver = ExactSolver(episode)
        optimum = solver.value(episode)
        episode.step(Action[frame["action"]])
        assert frame["value"] == solver.value(episode)
        assert frame["regret"] == optimum - frame["value"]
        while not frame["done"]:
            page.send("fly", flight=1, direction="WAIT")
            frame = page.until("frames")["frames"][0]["frame"]
            assert frame["done"] or (frame["value"], frame["regret"]) == (None, None)
        assert not [message for message in page.skipped if message["type"] == "values" and message["flight"] == 1]
        values = page.until("values")
        analysis = analyse_actions(Episode("easy", seed=7), [Action.WAIT] * frame["step"], "human")
        assert values["flight"] == 1
        assert values["values"] == list(analysis.values)
        assert values["regrets"] == [analysis.values[0] - value for value in analysis.values]


@pytest.mark.parametrize("command", [{"kind": "step"}, {"kind": "undo"}, {"kind": "help"}])
def test_a_session_that_another_page_has_flown_is_gone_for_this_one(client: TestClient, command: Message) -> None:
    with client.websocket_connect("/live") as one, client.websocket_connect("/live") as other:
        first, second = Page(one), Page(other)
        by_hand = command["kind"] != "step"
        session = first.start("human" if by_hand else "random")[0]["opening"]["session"]
        fly = {"kind": "fly", "direction": "WAIT"} if by_hand else command
        first.send(**fly)
        first.until("frames")
        second.send("attach", sessions=[session])
        second.until("flights")
        second.send(**fly)
        second.until("frames")
        first.send(**command)
        assert first.until("error")["code"] == "session_gone"
        second.send(**fly)
        assert second.until("frames")["frames"][0]["frame"]["step"] == 3


def test_flights_that_are_given_up_free_their_places(client: TestClient) -> None:
    with open_page(client) as page:
        first = page.start("greedy", "random")
        second = page.start("optimal")
        for shown in first:
            assert client.get("/state", headers={"X-Session-Id": shown["opening"]["session"]}).status_code == 410
        header = {"X-Session-Id": second[0]["opening"]["session"]}
        page.send("end")
        assert page.until("flights")["flights"] == []
        assert client.get("/state", headers=header).status_code == 410


def test_pilots_begin_at_the_moment_that_is_asked_for(client: TestClient) -> None:
    whole = directions(flown("easy", "greedy"))
    with open_page(client) as page:
        by_itself, by_hand = page.start("greedy", "human", step=3)
        assert [frame["action"] for frame in by_itself["frames"]] == [None, *whole[:3]]
        assert len(by_hand["frames"]) == 1
        ended = page.start("greedy", step=1000)[0]["frames"]
        assert [frame["action"] for frame in ended[1:]] == whole
        assert page.until("ended")["episode"]["agent"] == "greedy"


def test_an_open_page_keeps_its_paused_flight(tmp_path: Path, clock: Clock) -> None:
    # Looked for every 0.25 s; idle by the test's clock alone.
    app = create_app(Settings(data=tmp_path, idle_seconds=1), clock)
    with TestClient(app) as client:
        with client.websocket_connect("/live") as socket:
            session = Page(socket).start("human")[0]["opening"]["session"]
            header = {"X-Session-Id": session}
            for _ in range(3):
                clock.now += 0.9

                def is_kept() -> bool:
                    with closing(sqlite3.connect(tmp_path / FILE_NAME)) as file:
                        ((used,),) = file.execute("SELECT touched_at FROM sessions")
                    return used == pytest.approx(clock.now, abs=0.001)

                eventually(is_kept)
            assert client.get("/state", headers=header).status_code == 200
        eventually(lambda: not app.state.live.pages)
        clock.now += 1
        eventually(lambda: client.get("/state", headers=header).status_code == 410)
