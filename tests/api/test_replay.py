"""Flights of the past: frame by frame, annotated, listed with the optima of their maps."""

import re
from dataclasses import replace
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.agents.pathqnet import shipped_network
from drone_env.core.actions import Action, Outcome
from drone_env.core.cells import CELL_KINDS
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.flights.record import EpisodeRecord, record_of, replay
from drone_env.flights.store import Store
from drone_env.planning.optimal import solve, solve_episode
from drone_env.results.analysis import analyse_flight
from tests.api.flying import flown

JSON = {"Content-Type": "application/json"}


def record(task: str = "hard", seed: int = 7, agent: str = "greedy", steps: int | None = None) -> EpisodeRecord:
    return record_of(flown(task, agent, steps, seed), agent)


@pytest.mark.parametrize("task", TASKS)
def test_a_record_is_shown_frame_by_frame(shared_client: TestClient, task: str) -> None:
    flight = record(task)
    shown = shared_client.post("/replay", content=flight.to_json(), headers=JSON).json()
    frames = shown["frames"]
    assert [frame["action"] for frame in frames] == [None, *flight.actions]
    assert [frame["reward"] for frame in frames[1:]] == flight.rewards
    assert (frames[-1]["score"], frames[-1]["done"]) == (flight.score, True)
    assert frames[-1]["deliveries_done"] == len(frames[-1]["delivered"]) == flight.deliveries
    assert all((frame["q_values"] is None) == (not task.endswith("_delivery") or frame["done"]) for frame in frames)
    assert (shown["opening"]["pilot"], shown["opening"]["session"]) == ("greedy", None)


def test_a_flight_that_has_not_ended_is_shown_but_not_annotated(shared_client: TestClient) -> None:
    flight = record(steps=5)
    assert len(shared_client.post("/replay", content=flight.to_json(), headers=JSON).json()["frames"]) == 6
    refused = shared_client.post("/annotate", content=flight.to_json(), headers=JSON)
    assert (refused.status_code, refused.json()["code"]) == (409, "in_flight")


@pytest.mark.parametrize(
    ("change", "wrong"),
    [({"score": 0.5}, "score"), ({"task": "nowhere"}, "nowhere"), ({"agent": "a\nb"}, "agent"), ({"more": 1}, "more")],
)
def test_a_record_that_does_not_fit_its_flight_is_refused(
    shared_client: TestClient, change: dict[str, Any], wrong: str
) -> None:
    for path in ("/replay", "/annotate"):
        answer = shared_client.post(path, json=record().model_dump() | change)
        assert answer.status_code == 422
        assert wrong in answer.json()["detail"]


@pytest.mark.parametrize(("task", "agent"), [("hard", "random"), ("skyline_easy", "greedy")])
def test_an_annotation_is_the_analysis_beside_a_best_flight(shared_client: TestClient, task: str, agent: str) -> None:
    flight = record(task, agent=agent)
    told = shared_client.post("/annotate", content=flight.to_json(), headers=JSON).json()
    analysis = analyse_flight(flight)
    assert [move["regret"] for move in told["moves"]] == [move.regret for move in analysis.moves]
    optimum = told["optimum"]
    assert (told["score"], optimum["score"]) == (flight.score, analysis.optimum)
    start = Episode(task, "tiered", 7)
    best = start.copy().fly([Action[action] for action in optimum["actions"]])
    assert optimum["path"] == [list(start.position), *([at.x, at.y] for at in best.path)]
    assert (best.steps, best.score) == (optimum["steps"], analysis.optimum)


def best_after(episode: Episode, action: Action) -> Episode:
    """A best flight that goes on with an action."""
    flight = episode.copy().fly([action])
    return flight if flight.ended else flight.fly(solve_episode(flight).actions)


@pytest.mark.parametrize(
    ("task", "seed", "agent", "kind"),
    [
        ("medium", 0, "random", "DOWN or RIGHT keeps 3 of 3 parcels in reach, not 2"),
        ("hard", 0, "greedy", "RIGHT saves 2 steps and leaves 2 more battery units"),
        ("skyline_easy", 3, "greedy", "UP leaves 6 more battery units"),
    ],
)
def test_the_worst_move_says_what_the_best_ones_gain(
    shared_client: TestClient, task: str, seed: int, agent: str, kind: str
) -> None:
    flight = flown(task, agent, seed=seed)
    told = shared_client.post("/annotate", content=record_of(flight, "me").to_json(), headers=JSON).json()
    regrets = [move["regret"] for move in told["moves"]]
    step = regrets.index(max(regrets)) + 1
    assert told["worst"] == {"first": step, "last": step, "regret": max(regrets), "why": kind}
    # The same from the planner, which the server does not ask.
    worst = told["moves"][step - 1]["best_actions"][-1]
    start = Episode(task, "tiered", seed).fly(flight.actions[: step - 1])
    best, after = (best_after(start, action) for action in (Action[worst], flight.actions[step - 1]))
    numbers = {*map(int, re.findall(r"\d+", kind))}
    if best.deliveries_done > after.deliveries_done:
        assert numbers == {best.deliveries_done, after.deliveries_done}
    else:
        gains = (after.steps - best.steps, best.battery_units - after.battery_units)
        assert numbers == {gain for gain in gains if gain > 0}


@pytest.mark.parametrize(
    ("task", "actions", "why"),
    [
        (
            "skyline_easy",
            ["LEFT", "RIGHT"] * 6,
            "The drone flew back and forth for 10 steps (2 to 11); then the battery was empty.",
        ),
        ("skyline_easy", ["UP", "LEFT", "DOWN"] * 5, "Buildings cost 3 units; a pad was 3 cells away."),
        # The last step drains only what is left.
        (
            "skyline_easy",
            ["UP", "RIGHT", "UP", "RIGHT", "RIGHT", "UP", "RIGHT", "LEFT", "DOWN", "UP", "LEFT"],
            "Buildings cost 3 units; a pad was 1 cell away.",
        ),
        (
            "skyline_easy",
            ["DOWN", "DOWN", "LEFT", "LEFT", "LEFT", "LEFT", "DOWN", "UP"],  # leaves the pad and comes back
            "Buildings cost 3 units and trees cost 2 units; the drone reached a pad with an empty battery.",
        ),
        (
            "skyline_easy",
            ["UP", "DOWN", "UP", "UP", "DOWN", "UP", "UP", *["RIGHT"] * 4],
            "Each step costs a unit; the drone was on a pad and did not wait.",
        ),
        (
            "easy",
            ["WAIT"] * 60,
            "The drone stayed on one cell for 60 steps (1 to 60); then the battery was empty.",
        ),
    ],
)
def test_a_failed_flight_says_why_and_from_where_it_could_still_be_won(
    shared_client: TestClient, task: str, actions: list[str], why: str
) -> None:
    episode = Episode(task, "tiered", 7)
    won = []
    for name in actions:
        if episode.ended:
            break
        won.append(episode.copy().fly(solve_episode(episode).actions).outcome is Outcome.DELIVERED)
        episode.step(Action[name])
    told = shared_client.post("/annotate", content=record_of(episode, "me").to_json(), headers=JSON).json()
    assert (told["why"], told["rescue_step"]) == (why, sum(won) - 1)
    best = record(task, agent="optimal")
    told = shared_client.post("/annotate", content=best.to_json(), headers=JSON).json()
    assert (told["why"], told["rescue_step"], told["worst"]) == ("", None, None)


def test_episodes_are_listed_in_pages_with_the_optima_of_their_maps(
    client: TestClient, settings: dict[str, Any]
) -> None:
    flights = [("greedy", 0), ("greedy", 1), ("greedy", 2), ("random", 0), ("random", 1)]
    with Store(settings["data"]) as store:
        for agent, seed in flights:
            store.add_episode(replay(record("easy", seed, agent)), agent)
    rows = client.get("/episodes").json()
    assert [(row["agent"], row["seed"]) for row in rows["episodes"]] == flights[::-1]
    assert rows["next"] is None
    for row in rows["episodes"]:
        assert row["optimal_score"] == solve(TASKS["easy_delivery"], row["seed"]).score
        assert row["regret"] == row["optimal_score"] - row["score"]
    first = client.get("/episodes?limit=2").json()
    second = client.get(f"/episodes?limit=2&before={first['next']}").json()
    third = client.get(f"/episodes?limit=2&before={second['next']}").json()
    assert first["episodes"] + second["episodes"] + third["episodes"] == rows["episodes"]
    assert third["next"] is None
    assert client.get("/episodes?limit=5").json() == rows
    assert client.get("/episodes?agent=random").json()["episodes"] == rows["episodes"][:2]
    assert client.get("/episodes?task=hard").json()["episodes"] == []


def test_flights_of_a_task_that_is_gone_with_its_plugin_are_listed_without_their_optimum(
    client: TestClient, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = replace(TASKS["easy_delivery"], id="gone", short_name="gone", grader="drone_env.graders:grade_gone")
    with monkeypatch.context() as plugin, Store(settings["data"]) as store:
        plugin.setitem(TASKS, gone.id, gone)
        for task in ("easy", "gone"):
            store.add_episode(replay(record(task)), "me")
    optima = [("gone", None, None), ("easy_delivery", solve("easy", 7).score, 0)]
    for path in ("/episodes", "/memory_logs"):
        listed = client.get(path).json()["episodes"]
        assert [(row["task"], row["optimal_score"], row["regret"]) for row in listed] == optima


def test_who_can_fly_and_what_can_stand_in_a_cell(shared_client: TestClient) -> None:
    pilots = {pilot["id"]: pilot for pilot in shared_client.get("/pilots").json()["pilots"]}
    assert [name for name, pilot in pilots.items() if not pilot["automatic"]] == ["human"]
    assert len({pilot["colour"] for pilot in pilots.values()}) == len(pilots)
    assert pilots["pathqnet"]["tasks"] == ["easy_delivery", "medium_delivery", "hard_delivery"]
    assert pilots["ppo"]["tasks"] == [task.id for task in TASKS.values() if shipped_network(task, "ppo").exists()]
    assert pilots["greedy"]["tasks"] == pilots["tournet"]["tasks"] == list(TASKS)
    kinds = shared_client.get("/kinds").json()["kinds"]
    assert [(kind["id"], kind["name"]) for kind in kinds] == [(cell, kind.name) for cell, kind in CELL_KINDS.items()]
