"""`POST /values`: what can still be reached from a moment of a flight, beside the solver and the networks."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.agents.tournet import TournetAgent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.models import DIRECTIONS, Direction
from drone_env.planning import optimal
from drone_env.planning.cell_states import battery_range, charging_pads
from drone_env.results.analysis import analyse_flight
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.api.networks import put_network, put_tour, put_trained
from tests.api.test_replay import JSON, record
from tests.toy import TOY

Answer = dict[str, Any]


def ask(client: TestClient, task: str, seed: int, actions: list[Direction], **more: object) -> Answer:
    body = {"task": task, "seed": seed, "actions": actions, **more}
    return client.post("/values", json=body).raise_for_status().json()


@pytest.mark.parametrize(("task", "agent"), [("hard", "random"), ("skyline_medium", "greedy")])
def test_along_a_flight_the_values_are_those_of_its_analysis_to_the_last_bit(
    shared_client: TestClient, task: str, agent: str
) -> None:
    flown = record(task, agent=agent)
    analysis = analyse_flight(flown)
    told = shared_client.post("/annotate", content=flown.to_json(), headers=JSON).json()
    solver = optimal.solver_of(Episode(task, seed=7))
    flight = Episode(task, seed=7)
    asked = {0, len(flown.actions) // 2, len(flown.actions) - 1}
    for step, action in enumerate(flown.actions):
        if step in asked:
            answer = ask(shared_client, task, 7, flown.actions[:step])
            assert answer["value"] == analysis.values[step] == told["moves"][step]["value"]
            assert answer["regret"] == analysis.optimum - analysis.values[step]
            assert answer["best_actions"] == told["moves"][step]["best_actions"]
            assert answer["q_values"] == dict(zip(DIRECTIONS, solver.q_values(flight).tolist(), strict=True))
            alone = ask(shared_client, task, 7, flown.actions[:step], only="range")
            assert (alone["range"], alone["pads"]) == (answer["range"], answer["pads"])
            assert (alone["optimum"], alone["cells"], alone["q_values"]) == (None, None, None)
            moves = ask(shared_client, task, 7, flown.actions[:step], only="moves")
            assert moves == {**answer, "network": None, "cells": None, "range": None, "pads": None}
            x, y = answer["position"]
            assert answer["cells"]["values"][y][x] == answer["value"]
            assert answer["cells"]["q_values"][y][x] == list(answer["q_values"].values())
            assert answer["cells"]["best_actions"][y][x] == answer["best_actions"]
        flight.step(Action[action])
    ended = ask(shared_client, task, 7, flown.actions)
    assert (ended["done"], ended["value"], ended["regret"]) == (True, flown.score, analysis.regret)
    assert [ended[name] for name in ("q_values", "best_actions", "network", "cells", "range", "pads")] == [None] * 6


def test_where_the_drone_cannot_be_there_is_nothing_and_ranges_are_told_from_here_and_from_each_pad(
    shared_client: TestClient,
) -> None:
    flight = Episode("skyline_medium", seed=4).fly([Action.UP, Action.LEFT])
    answer = ask(shared_client, "skyline_medium", 4, ["UP", "LEFT"])
    width, grid = flight.task.width, flight.grid()
    closed = {(x, y) for y in range(width) for x in range(width) if int(grid[y, x]) in flight.task.impassable}
    for rows in answer["cells"].values():
        assert {(x, y) for y, row in enumerate(rows) for x, item in enumerate(row) if item is None} == closed

    def told(cell: int, units: int) -> list[list[int | None]]:
        most = battery_range(flight, cell, units).tolist()
        rows = [most[start : start + width] for start in range(0, len(most), width)]
        return [[None if units < 0 else units for units in row] for row in rows]

    assert answer["range"] == told(flight.cell, flight.battery_units)
    assert answer["pads"] == [
        {"position": [pad % width, pad // width], "units": told(pad, flight.task.battery_capacity)}
        for pad in charging_pads(flight)
    ]
    assert len(answer["pads"]) == 4


def test_the_network_says_at_the_drone_what_it_flies_and_disagrees_where_that_is_not_best(
    shared_client: TestClient,
) -> None:
    flown = record("hard", agent="tournet")
    disagreed = 0
    for step in (0, len(flown.actions) // 2):
        answer = ask(shared_client, "hard", 7, flown.actions[:step])
        assert answer["network"]["digest"] == TournetAgent(TASKS["hard_delivery"]).config["network"]
        x, y = answer["position"]
        cells = answer["cells"]
        assert cells["network_actions"][y][x] == flown.actions[step]
        for rows in zip(cells["network_actions"], cells["best_actions"], cells["disagree"], strict=True):
            for flies, best, disagrees in zip(*rows, strict=True):
                assert disagrees == (None if flies is None else flies not in best)
                disagreed += bool(disagrees)
    assert disagreed


def test_which_network_is_asked(tmp_path: Path) -> None:
    easy, data, weights = TASKS["easy_delivery"], tmp_path / "data", tmp_path / "weights"
    weights.mkdir()

    def asked(client: TestClient) -> object:
        answer = ask(client, "easy", 7, [])
        assert (answer["network"] is None) == (answer["cells"]["disagree"] is None)
        return answer["network"] and answer["network"]["pilot"]

    with TestClient(create_app(Settings(data=data, weights=weights))) as client:
        assert asked(client) is None
        put_network(easy, weights)
        assert asked(client) == "pathqnet"
        put_trained(easy, data)
        assert asked(client) == "trained"
        put_tour(weights / "tournet_v1.safetensors")
        assert asked(client) == "tournet"
        put_tour(data / "tournet.safetensors")
        assert asked(client) == "trained-tournet"


def test_a_map_too_large_to_be_solved_is_told_of_by_the_network_alone(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = replace(TOY, width=20, height=20, deliveries=16, max_steps=600, battery_capacity=600)
    monkeypatch.setitem(TASKS, large.id, large)
    answer = ask(client, "toy", 1, ["UP"])
    assert "GB are allowed" in answer["unsolved"]
    assert [answer[name] for name in ("value", "optimum", "regret", "q_values", "best_actions")] == [None] * 5
    cells = answer["cells"]
    assert (cells["values"], cells["best_actions"], cells["disagree"]) == (None, None, None)
    assert all(flies in DIRECTIONS for row in cells["network_actions"] for flies in row)


HEAD = {"task": "easy", "seed": 7, "actions": ["UP"]}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 1 << 53}, "less than or equal to"),
        ({"actions": ["WAIT"] * 61}, "the flight ends after 60 steps, but there are 61 actions"),
    ],
)
def test_a_flight_that_cannot_be_is_refused(shared_client: TestClient, change: Answer, told: str) -> None:
    refused = shared_client.post("/values", json=HEAD | change)
    assert refused.status_code == 422
    assert told in refused.json()["detail"]
