"""The WebSocket of the page: missions that fly by themselves or by hand, and come back after a loss."""

import base64
import itertools
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from drone_env.agents import make_agent
from drone_env.analysis import analyse_actions
from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import get_task
from drone_env.models import DroneObservation
from drone_env.planning import exact
from drone_env.planning.exact import ExactSolver
from drone_env.server.app import create_app
from drone_env.server.live.commands import MOST_MISSIONS
from drone_env.server.live.feeds import Feed
from drone_env.server.live.missions import LiveMission
from drone_env.server.live.values import UNSOLVED
from drone_env.server.settings import Settings
from tests.api.conftest import Clock
from tests.api.networks import put_trained

Message = dict[str, Any]


class Page:
    """A page that has opened `/live`."""

    def __init__(self, socket: WebSocketTestSession) -> None:
        self.socket = socket
        self.ended: list[int] = []
        """The missions that were told to have ended, while they flew by themselves."""

    def send(self, kind: str, **fields: Any) -> None:
        self.socket.send_text(json.dumps({"type": kind, **fields}))

    def until(self, kind: str) -> Message:
        """The next message of a kind; others are read over, but for errors."""
        while True:
            message = json.loads(self.socket.receive_text())
            if message["type"] == kind:
                return message
            assert message["type"] != "error", message

    def start(self, *pilots: str, task: str = "easy", seed: int | None = 7, **fields: Any) -> list[Message]:
        self.send("start", task=task, seed=seed, pilots=pilots, **fields)
        return self.until("missions")["missions"]

    def flight(self) -> dict[int, list[Message]]:
        """The frames of each mission until all have ended."""
        frames: dict[int, list[Message]] = {}
        while True:
            message = json.loads(self.socket.receive_text())
            for moved in message["frames"] if message["type"] == "frames" else ():
                frames.setdefault(moved["mission"], []).append(moved["frame"])
            if message["type"] == "ended":
                self.ended.append(message["mission"])
            if message["type"] == "playing" and not message["playing"]:
                return frames


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


@pytest.mark.parametrize("task", ["easy", "hard"])
def test_a_race_is_what_the_agents_fly(client: TestClient, task: str) -> None:
    pilots = ["pathqnet", "greedy", "optimal", "random"]
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        missions = page.start(*pilots, task=task, reward_profile="composite")
        assert [mission["mission"]["pilot"] for mission in missions] == pilots
        page.send("play", speed=60)
        assert page.until("playing")["playing"]
        frames = page.flight()
        assert sorted(page.ended) == [0, 1, 2, 3]
    for number, pilot in enumerate(pilots):
        episode = flown(task, 7, pilot, "composite")
        assert names(frames[number]) == [Action(action).name for action in episode.actions]
        last = frames[number][-1]
        assert [frame["reward"] for frame in frames[number]] == episode.rewards
        assert (last["score"], last["done"], last["efficiency"]) == (episode.score, True, episode.efficiency)
    stored = {row["agent"]: row for row in client.get("/episodes").json()["episodes"]}
    assert {agent: row["score"] for agent, row in stored.items()} == {
        pilot: frames[number][-1]["score"] for number, pilot in enumerate(pilots)
    }
    assert stored["optimal"]["regret"] == 0


def test_the_network_that_was_trained_here_flies_beside_the_shipped_one(
    client: TestClient, settings: dict[str, Any]
) -> None:
    file = put_trained(get_task("easy"), settings["data"])
    pilots = {"trained": f"pathqnet:{file}", "pathqnet": "pathqnet"}
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start(*pilots)
        page.send("play", speed=60)
        frames = page.flight()
    for number, agent in enumerate(pilots.values()):
        episode = flown("easy", 7, agent)
        assert names(frames[number]) == [Action(action).name for action in episode.actions]
        # Each is shown with what its own network thinks.
        for frame, following in itertools.pairwise(frames[number]):
            assert following["action"] == max(frame["q_values"], key=frame["q_values"].get)
    assert names(frames[0]) != names(frames[1])


def test_a_broken_network_grounds_its_own_pilot_alone(client: TestClient, settings: dict[str, Any]) -> None:
    (settings["data"] / "easy.npz").write_bytes(b"nothing")
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.send("start", task="easy", seed=7, pilots=["greedy", "trained"])
        told = json.loads(socket.receive_text())
        assert (told["type"], told["code"]) == ("error", "no_network")
        assert "easy.npz is not an exported network" in told["detail"]
        shipped, greedy = page.start("pathqnet", "greedy")
        assert shipped["frames"][0]["q_values"] is not None
        assert greedy["frames"][0]["q_values"] is None
        page.send("step")
        assert [moved["mission"] for moved in page.until("frames")["frames"]] == [0, 1]
        page.send("start", task="medium", seed=7, pilots=["trained"])
        told = json.loads(socket.receive_text())
        assert (told["type"], told["code"]) == ("error", "unsupported")
        assert "there is no network for 'medium_delivery'" in told["detail"]
    assert client.get("/health").status_code == 200


def test_a_frame_shows_what_the_observation_says(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        (shown,) = page.start("human", task="medium")
        mission, frame = shown["mission"], shown["frames"][0]
        header = {"X-Session-Id": mission["session"]}
        grid = client.get("/state", headers=header).json()["grid"]
        x, y = mission["start"]
        assert grid[y][x] == 6
        grid[y][x] = mission["cells"][y][x]
        assert grid == mission["cells"]
        for direction in ("UP", "DOWN", "LEFT", "RIGHT", "WAIT", "UP"):
            page.send("fly", direction=direction)
            frame = page.until("frames")["frames"][0]["frame"]
        state = client.get("/state", headers=header).json()
        for name in ("battery", "deliveries_done", "reward_total", "score", "done", "outcome"):
            assert frame[name] == state[name]
        assert (frame["x"], frame["y"], frame["step"]) == (state["drone_x"], state["drone_y"], state["step_count"])
        assert frame["target"] == state["current_target"]
        assert frame["q_values"] == client.post("/predict", headers=header).json()["q_values"]
        assert frame["event"] == state["path_history"][-1]["event"]


def test_an_agent_is_told_its_regret_in_flight_and_a_person_after_the_end(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("random", "human")
        known = page.until("values")
        assert known["mission"] == 0
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
            page.send("fly", mission=1, direction="WAIT")
            frame = page.until("frames")["frames"][0]["frame"]
            assert frame["done"] or (frame["value"], frame["regret"]) == (None, None)
        values = page.until("values")
        start = Episode("easy")
        start.reset(7)
        analysis = analyse_actions(start, [Action.WAIT] * frame["step"], "human")
        assert values["mission"] == 1
        assert values["values"] == list(analysis.values)
        assert values["regrets"] == [analysis.values[0] - value for value in analysis.values]


def test_pause_speed_and_single_steps(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("greedy", task="hard")
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1
        page.send("play", speed=2)
        started = time.perf_counter()
        steps = [page.until("frames")["frames"][0]["frame"]["step"] for _ in range(3)]
        assert steps == [2, 3, 4]
        assert 0.9 < time.perf_counter() - started
        page.send("pause")
        assert page.until("playing")["playing"] is False
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 5


def test_a_page_that_comes_back_goes_on_where_it_was(client: TestClient) -> None:
    pilots = ["random", "optimal", "human"]
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        sessions = [shown["mission"]["session"] for shown in page.start(*pilots)]
        for _ in range(3):
            page.send("step")
            page.until("frames")
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.send("attach", sessions=sessions)
        missions = page.until("missions")["missions"]
        assert [mission["mission"]["pilot"] for mission in missions] == pilots
        assert [len(mission["frames"]) for mission in missions] == [4, 4, 1]
        page.send("play", speed=60)
        assert page.until("playing")["playing"]
        frames = page.flight()
    for number in (0, 1):
        whole = names(missions[number]["frames"][1:] + frames[number])
        assert whole == [Action(action).name for action in flown("easy", 7, pilots[number]).actions]


def test_two_pages_on_one_session_never_fly_it_astray(client: TestClient) -> None:
    with client.websocket_connect("/live") as one, client.websocket_connect("/live") as other:
        first, second = Page(one), Page(other)
        session = first.start("random", task="medium")[0]["mission"]["session"]
        second.send("attach", sessions=[session])
        second.until("missions")
        flights: list[list[Message]] = [[], []]
        for turn in range(12):
            for page, seen in ((first, flights[0]), (second, flights[1]))[:: 1 if turn % 3 else -1]:
                page.send("step")
                seen.extend(moved["frame"] for moved in page.until("frames")["frames"])
    actions = [Action(action).name for action in flown("medium", 7, "random").actions]
    for seen in flights:
        assert [frame["step"] for frame in seen] == list(range(1, len(seen) + 1))
        assert names(seen) == actions[: len(seen)]


def test_a_page_has_one_map_solved_at_a_time_and_none_when_it_has_gone(
    client: TestClient, eventually: Callable[..., None]
) -> None:
    values, go_on = client.app.state.live.values, threading.Event()  # type: ignore[attr-defined]
    values._thread.submit(go_on.wait)
    try:
        with client.websocket_connect("/live") as socket:
            page = Page(socket)
            for seed in range(20):
                page.start("greedy", seed=seed)
            eventually(lambda: [seed for _, seed in values._pending] == [19])
        eventually(lambda: not values._pending)
    finally:
        go_on.set()


def test_missions_that_are_given_up_free_their_places(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        first = page.start("greedy", "random")
        second = page.start("optimal")
        for shown in first:
            assert client.get("/state", headers={"X-Session-Id": shown["mission"]["session"]}).status_code == 410
        header = {"X-Session-Id": second[0]["mission"]["session"]}
        assert client.get("/state", headers=header).status_code == 200
        page.send("end")
        assert page.until("missions")["missions"] == []
        assert client.get("/state", headers=header).status_code == 410


def test_without_a_seed_the_next_map_follows(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        first = page.start("greedy", "random", seed=None)
        assert len({shown["mission"]["seed"] for shown in first}) == 1
        episode = Episode("easy")
        episode.reset(first[0]["mission"]["seed"])
        assert page.start("greedy", seed=None)[0]["mission"]["seed"] == episode.reset()


def test_an_open_page_keeps_its_paused_mission(tmp_path: Path, clock: Clock, eventually: Callable[..., None]) -> None:
    # Looked for every 0.25 s; idle by the test's clock alone.
    app = create_app(Settings(data=tmp_path, idle_seconds=1), clock)
    with TestClient(app) as client:
        with client.websocket_connect("/live") as socket:
            session = Page(socket).start("human")[0]["mission"]["session"]
            header = {"X-Session-Id": session}
            for _ in range(3):
                clock.now += 0.9

                def is_kept() -> bool:
                    used = app.state.shared.store.read_session(session).touched_at.timestamp()
                    return used == pytest.approx(clock.now, abs=0.001)

                eventually(is_kept)
            assert client.get("/state", headers=header).status_code == 200
        eventually(lambda: not app.state.live.cockpits)
        clock.now += 1
        eventually(lambda: client.get("/state", headers=header).status_code == 410)


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        ("", "invalid_request"),
        ("[]", "invalid_request"),
        ("NaN", "invalid_request"),
        ({"type": "land"}, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": []}, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": ["greedy"] * (MOST_MISSIONS + 1)}, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": ["greedy"], "seed": -1}, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": ["ghost"]}, "unknown_name"),
        ({"type": "start", "task": "nowhere", "pilots": ["greedy"]}, "unknown_name"),
        ({"type": "start", "task": "easy", "pilots": ["greedy"], "reward_profile": "gold"}, "unknown_name"),
        ({"type": "start", "task": "skyline_easy", "pilots": ["greedy", "pathqnet"]}, "unsupported"),
        ({"type": "attach", "sessions": ["nobody"]}, "session_gone"),
        ({"type": "fly", "direction": "UP"}, "wrong_moment"),
        ({"type": "fly", "direction": "UP", "mission": 3}, "unknown_name"),
        ({"type": "fly", "direction": "up"}, "invalid_request"),
        ({"type": "play", "speed": 1e9}, "invalid_request"),
        ({"type": "subscribe", "topics": ["passwords"]}, "invalid_request"),
    ],
)
def test_what_cannot_be_obeyed_is_told_and_changes_nothing(shared_client: TestClient, frame: Any, code: str) -> None:
    with shared_client.websocket_connect("/live") as socket:
        page = Page(socket)
        (shown,) = page.start("greedy")
        page.until("values")
        socket.send_text(frame if isinstance(frame, str) else json.dumps(frame))
        message = json.loads(socket.receive_text())
        assert (message["type"], message["code"]) == ("error", code)
        assert message["detail"]
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1
        state = shared_client.get("/state", headers={"X-Session-Id": shown["mission"]["session"]}).json()
        assert state["step_count"] == 1


def test_a_session_that_is_not_the_page_s_is_refused(client: TestClient, session: dict[str, str]) -> None:
    with client.websocket_connect("/live") as socket:
        socket.send_text(json.dumps({"type": "attach", "sessions": [session["X-Session-Id"]]}))
        assert json.loads(socket.receive_text())["code"] == "wrong_moment"


@pytest.mark.parametrize(("seed", "steps"), [(8, 0), (7, 2)])
def test_a_session_that_was_taken_elsewhere_is_not_flown(client: TestClient, seed: int, steps: int) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        header = {"X-Session-Id": page.start("greedy")[0]["mission"]["session"]}
        page.until("values")
        page.send("step")
        page.until("frames")
        client.post("/reset", headers=header, json={"seed": seed, "agent": "greedy"})
        for _ in range(steps):
            client.post("/step", headers=header, json={"direction": "WAIT"})
        page.send("step")
        message = json.loads(socket.receive_text())
        assert (message["type"], message["code"]) == ("error", "session_gone")
        assert client.get("/state", headers=header).json()["step_count"] == steps
        # Gone altogether, it is in nobody's way.
        client.delete("/session", headers=header)
        assert page.start("greedy")


def test_after_the_end_nobody_flies_on_by_hand(client: TestClient) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("human")
        for _ in range(60):
            page.send("fly", direction="WAIT")
        assert page.until("ended")["episode"]["steps"] == 60
        page.until("values")
        page.send("fly", direction="WAIT")
        page.send("land")  # answered in any case
        message = json.loads(socket.receive_text())
        assert (message["type"], message["code"]) == ("error", "wrong_moment")
        assert "start another" in message["detail"]


def test_a_page_is_told_once_that_a_map_could_not_be_solved_and_flies_on(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as today, client.websocket_connect("/live") as socket:
        today.setattr(exact, "map_graph", lambda _: {}[0])
        page = Page(socket)
        (shown,) = page.start("greedy")
        refused = json.loads(socket.receive_text())
        assert (refused["type"], refused["code"], refused["detail"]) == ("error", "no_values", UNSOLVED)
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["value"] is None
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.send("attach", sessions=[shown["mission"]["session"]])
        assert len(page.until("missions")["missions"][0]["frames"]) == 2
        assert len(page.until("values")["values"]) == 2


def test_what_nobody_foresaw_ends_no_connection(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("greedy")
        page.until("values")
        with monkeypatch.context() as today:
            today.setattr(LiveMission, "step", lambda _: {}["a fault"])
            page.send("step")
            message = json.loads(socket.receive_text())
            assert (message["type"], message["code"]) == ("error", "internal")
            assert message["detail"] == "the server failed; its log says why"
        assert "KeyError: 'a fault'" in caplog.text
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1


def test_news_that_cannot_be_told_are_an_error_once(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, eventually: Callable[[Callable[[], bool]], None]
) -> None:
    asked: list[Feed] = []
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        with monkeypatch.context() as today:
            today.setattr(Feed, "news", lambda feed: asked.append(feed) or {}["a fault"])
            page.send("subscribe", topics=["training"])
            assert json.loads(socket.receive_text())["type"] == "error"
            eventually(lambda: len(asked) > 2)
        assert page.until("training")["lines"] == []


def test_news_of_the_server(
    client: TestClient, settings: dict[str, Any], eventually: Callable[[Callable[[], bool]], None]
) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        client.get("/health")
        page.send("subscribe", topics=["requests", "training", "episodes"])
        assert [request["path"] for request in page.until("requests")["requests"]] == ["/health"]
        assert page.until("training")["lines"] == []
        assert page.until("episodes")["episodes"] == []
        (settings["data"] / "train.log").write_text("<b>episode 1</b>\n")
        assert page.until("training")["lines"] == ["<b>episode 1</b>"]
        for agent in ("<i>me</i>", "another"):
            header = {"X-Session-Id": client.post("/reset", json={"seed": 7, "agent": agent}).json()["session_id"]}
            observation = {"done": False}
            while not observation["done"]:
                observation = client.post("/step", headers=header, json={"direction": "WAIT"}).json()
            # What was told before is not told again.
            (episode,) = page.until("episodes")["episodes"]
            assert (episode["agent"], episode["steps"], episode["success"]) == (agent, 60, False)
        assert episode["regret"] == episode["optimal_score"] - episode["score"]
        page.send("subscribe", topics=[])
        client.get("/health")
        page.send("start", task="easy", pilots=["greedy"])
        page.until("missions")


class TestToken:
    @pytest.fixture
    def settings(self, tmp_path: Path) -> dict[str, Any]:
        return {"data": tmp_path, "token": "s3cret/+?"}

    def test_a_page_offers_the_token_as_a_subprotocol(self, client: TestClient) -> None:
        offered = base64.urlsafe_b64encode(b"s3cret/+?").decode().rstrip("=")
        with client.websocket_connect("/live", subprotocols=["drone-env", f"bearer.{offered}"]) as socket:
            assert socket.accepted_subprotocol == "drone-env"
            assert Page(socket).start("greedy")

    @pytest.mark.parametrize("offered", [[], ["drone-env"], ["drone-env", "bearer.wrong"], ["bearer.!"]])
    def test_without_it_nothing_is_opened(self, client: TestClient, offered: list[str]) -> None:
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("/live", subprotocols=offered):
            raise AssertionError("opened")

    def test_the_page_itself_is_open_and_nothing_behind_it(self, client: TestClient) -> None:
        assert client.get("/").status_code == 200
        assert client.get("/static/js/main.js").status_code == 200
        for path in ("/tasks", "/static/../tasks", "/static/splits", "/static/js", "/episodes", "/staticx"):
            assert client.get(path).status_code == 401


def test_a_full_house_of_pages_is_told_so(tmp_path: Path) -> None:
    with (
        TestClient(create_app(Settings(data=tmp_path, capacity=2))) as client,
        client.websocket_connect("/live") as socket,
        client.websocket_connect("/live"),
    ):
        page = Page(socket)
        (shown,) = page.start("greedy")
        with client.websocket_connect("/live") as late, pytest.raises(WebSocketDisconnect) as closed:
            late.receive_text()
        assert closed.value.code == 1013
        page.send("start", task="easy", pilots=["greedy", "random"], seed=7)
        message = json.loads(socket.receive_text())
        while message["type"] != "error":
            message = json.loads(socket.receive_text())
        assert message["code"] == "no_room"
        # The place that the first of the two had is free again, and the mission before them is flown on.
        assert client.post("/reset").status_code == 200
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1
        assert client.get("/state", headers={"X-Session-Id": shown["mission"]["session"]}).json()["step_count"] == 1


def test_the_observation_model_still_fits(client: TestClient) -> None:
    """The page reads frames; whoever reads observations beside it sees the same flight."""
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        (shown,) = page.start("human", task=get_task("skyline_easy").id)
        page.send("fly", direction="WAIT")
        page.until("frames")
        header = {"X-Session-Id": shown["mission"]["session"]}
        observation = client.post("/step", headers=header, json={"direction": "WAIT"}).json()
        assert DroneObservation.model_validate_json(json.dumps(observation)).step_count == 2
        page.send("fly", direction="WAIT")
        assert [moved["frame"]["step"] for moved in page.until("frames")["frames"]] == [2]
