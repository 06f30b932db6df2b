"""The flights of the page: those of agents to their ends, a person's step by step, and what is refused."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.tasks import get_task
from drone_env.server.app import create_app
from drone_env.server.routes.flights import MOST_FLIGHTS
from drone_env.server.settings import Settings
from tests.api.flying import ByHand, directions, flown, start
from tests.api.networks import put_network, put_policy, put_tour
from tests.unit.stores import open_sessions


def test_a_race_is_what_the_agents_fly_beside_what_pathqnet_thinks(tmp_path: Path) -> None:
    weights, data = tmp_path / "weights", tmp_path / "data"
    shipped, trained = put_tour(weights / "tournet_v1.safetensors"), put_tour(data / "tournet.safetensors", 1)
    pilots = {
        "trained-tournet": f"tournet:{trained}",
        "trained-ppo": f"ppo:{put_policy(get_task('hard'), data)}",
        "tournet": f"tournet:{shipped}",
        "pathqnet": f"pathqnet:{put_network(get_task('hard'), weights)}",
    }
    with TestClient(create_app(Settings(data=data, weights=weights))) as client:
        flights = start(client, *pilots, task="hard", reward_profile="composite")
        assert [shown["opening"]["pilot"] for shown in flights] == [*pilots]
        # Who opens the link again flies no other flight.
        assert start(client, *pilots, task="hard", reward_profile="composite") == flights
        stored = {row["id"]: (row["agent"], row["score"]) for row in client.get("/episodes").json()["episodes"]}
    assert len(stored) == len(pilots)
    for shown, (pilot, agent) in zip(flights, pilots.items(), strict=True):
        episode, frames = flown("hard", agent, profile="composite"), shown["frames"]
        assert [frame["action"] for frame in frames] == [None, *directions(episode)]
        assert [frame["reward"] for frame in frames[1:]] == episode.rewards
        assert {frame["q_values"] is not None for frame in frames[:-1]} == {True}
        last = frames[-1]
        assert (last["score"], last["done"], last["efficiency"]) == (episode.score, True, episode.efficiency)
        assert stored[shown["episode"]] == (pilot, last["score"])
        assert (shown["version"], shown["opening"]["session"]) == (None, None)
    assert len({str(directions(flown("hard", agent))) for agent in [*pilots.values()][:2]}) == 2


def test_a_broken_network_grounds_its_own_pilot_alone(client: TestClient, settings: dict[str, Any]) -> None:
    (settings["data"] / "easy.safetensors").write_bytes(b"nothing")
    told = client.post("/flights", json={"task": "easy", "seed": 7, "pilots": ["greedy", "trained"]}).json()
    assert told["code"] == "no_network"
    assert "easy.safetensors is not an exported network" in told["detail"]
    shipped, greedy = start(client, "pathqnet", "greedy")
    assert shipped["frames"][0]["q_values"] is not None
    assert greedy["frames"][0]["q_values"] is None


def test_a_frame_shows_what_the_observation_says(client: TestClient) -> None:
    (shown,) = start(client, "human", task="medium")
    flight, opening = ByHand(client, shown), shown["opening"]
    grid = client.get("/state", headers=flight.header).json()["grid"]
    x, y = shown["frames"][0]["x"], shown["frames"][0]["y"]
    assert grid[y][x] == 6
    grid[y][x] = opening["cells"][y][x]
    assert grid == opening["cells"]
    frame = flight.change("UP", "DOWN", "LEFT", "RIGHT", "WAIT", "UP")["frame"]
    state = client.get("/state", headers=flight.header).json()
    for name in ("battery", "deliveries_done", "reward_total", "score", "done", "outcome"):
        assert frame[name] == state[name]
    assert (frame["x"], frame["y"], frame["step"]) == (state["drone_x"], state["drone_y"], state["step_count"])
    assert frame["target"] == state["current_target"]
    assert frame["q_values"] is None
    assert frame["event"] == state["path_history"][-1]["event"]


@pytest.mark.parametrize("change", ["UP", "UNDO", "VALUES"])
def test_a_flight_that_somebody_else_has_changed_is_gone_for_this_page(client: TestClient, change: str) -> None:
    (shown,) = start(client, "human")
    page, other = ByHand(client, shown), ByHand(client, shown)
    page.change("WAIT", "WAIT")
    other.version = page.version
    # The same change again is the one whose response was lost.
    before = page.version
    answer = page.change(change)
    page.version = before
    assert page.change(change) == answer
    page.change("DOWN")
    assert other.change(change)["code"] == "session_gone"
    client.post("/reset", json={"seed": 7}, headers=page.header)
    assert page.change(change)["code"] == "session_gone"


def test_a_flight_by_hand_outlives_the_server_and_is_ended_by_its_page(settings: dict[str, Any]) -> None:
    with TestClient(create_app(Settings(**settings))) as client:
        flight = ByHand(client, start(client, "human")[0])
        flight.change("WAIT")
    with TestClient(create_app(Settings(**settings))) as client:
        flight.client = client
        assert flight.change("WAIT")["frame"]["step"] == 2
        assert client.delete("/session", headers=flight.header).status_code == 204
        assert flight.change("WAIT")["code"] == "session_gone"


def forking(pilot: str, **fork: Any) -> Any:
    fork = {"actions": ["WAIT"], "step": 1, "of": {"pilot": "greedy"}, **fork}
    return {"pilots": ["random", pilot], "fork": fork}


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ({"pilots": ["greedy"] * (MOST_FLIGHTS + 1)}, "invalid_request"),
        ({"pilots": ["greedy", "ghost"]}, "unknown_name"),
        ({"pilots": ["human", "greedy", "human"]}, "one person flies"),
        ({"task": "skyline_easy", "pilots": ["human", "pathqnet"]}, "unsupported"),
        ({**forking("human"), "seed": None}, "a fork needs the seed of its map"),
        (forking("human", step=2), "requires as many actions, got 1"),
        (forking("human", of={"pilot": "a\nb"}), "one printable line of 1 to 200 characters"),
        (forking("human", actions=["WAIT"] * 61), "ends after 60 steps, but there are 61 actions"),
        (forking("greedy"), "as the last pilot 'human'"),
    ],
)
def test_what_cannot_be_started_is_told_and_opens_nothing(shared_client: TestClient, body: Any, told: str) -> None:
    folder = shared_client.app.state.shared.store.folder  # type: ignore[attr-defined]
    opened = open_sessions(folder)
    answer = shared_client.post("/flights", json={"task": "easy", "seed": 7, **body}).json()
    assert told in f"{answer['code']}: {answer['detail']}"
    assert open_sessions(folder) == opened


@pytest.mark.parametrize(
    ("pilot", "told"),
    [
        ("human", "wrong_moment"),
        ("ghost", "unknown_name"),
    ],
)
def test_only_an_agent_is_flown_to_the_end(shared_client: TestClient, pilot: str, told: str) -> None:
    body = {"task": "easy", "seed": 7, "pilot": pilot}
    answer = shared_client.post("/flights/agent", json=body).json()
    assert told in f"{answer['code']}: {answer['detail']}"


def test_only_a_person_in_flight_changes_a_flight(client: TestClient) -> None:
    session = client.post("/reset", json={"seed": 7, "agent": "me"}).json()["session_id"]
    flight = ByHand(client, {"version": "x-0", "opening": {"session": session}})
    assert flight.change("UP")["code"] == "session_gone"
    flight.version = f"{client.app.state.shared.sessions.read(session).flight_id}-0"  # type: ignore[attr-defined]
    assert flight.change("UP")["detail"].startswith("me flies this session")
    flight = ByHand(client, start(client, "human")[0])
    assert flight.change("UNDO")["code"] == "wrong_moment"
    ended = flight.change(*["WAIT"] * 60)
    assert ended["frame"]["done"]
    assert client.get(f"/episodes/{ended['episode']}").json()["agent"] == "human"
    for change in ("WAIT", "UNDO", "VALUES"):
        flight.version = ended["version"]
        assert flight.change(change)["code"] == "wrong_moment"
