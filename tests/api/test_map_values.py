"""`POST /values`: what can still be reached from a moment of a flight, beside the solver."""

from dataclasses import replace
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.models import DIRECTIONS, Direction
from drone_env.planning import optimal
from drone_env.planning.cell_states import battery_range
from drone_env.results.analysis import analyse_flight
from tests.api.test_replay import record
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
    solver = optimal.solver_of(Episode(task, seed=7))
    flight = Episode(task, seed=7)
    asked = {0, len(flown.actions) // 2, len(flown.actions) - 1}
    for step, action in enumerate(flown.actions):
        if step in asked:
            answer = ask(shared_client, task, 7, flown.actions[:step])
            assert answer["along"] == list(analysis.values[: step + 1])
            assert (answer["optimum"], answer["value"]) == (analysis.optimum, analysis.values[step])
            assert answer["regret"] == analysis.optimum - analysis.values[step]
            assert answer["q_values"] == dict(zip(DIRECTIONS, solver.q_values(flight).tolist(), strict=True))
            alone = ask(shared_client, task, 7, flown.actions[:step], only="range")
            assert (alone["range"], alone["optimum"], alone["cells"]) == (answer["range"], None, None)
            moves = ask(shared_client, task, 7, flown.actions[:step], only="moves")
            assert moves == {**answer, "cells": None, "range": None}
            x, y = answer["position"]
            assert answer["cells"]["values"][y][x] == answer["value"]
            assert answer["cells"]["q_values"][y][x] == list(answer["q_values"].values())
        flight.step(Action[action])
    ended = ask(shared_client, task, 7, flown.actions)
    assert (ended["value"], ended["regret"], ended["along"]) == (flown.score, analysis.regret, list(analysis.values))
    assert [ended[name] for name in ("q_values", "cells", "range")] == [None] * 3


def test_closed_cells_have_no_values(shared_client: TestClient) -> None:
    flight = Episode("skyline_medium", seed=4).fly([Action.UP, Action.LEFT])
    answer = ask(shared_client, "skyline_medium", 4, ["UP", "LEFT"])
    width, grid = flight.task.width, flight.grid()
    closed = {(x, y) for y in range(width) for x in range(width) if int(grid[y, x]) in flight.task.impassable}
    for rows in answer["cells"].values():
        assert {(x, y) for y, row in enumerate(rows) for x, item in enumerate(row) if item is None} == closed
    units = battery_range(flight, flight.cell, flight.battery_units).tolist()
    assert [-1 if one is None else one for row in answer["range"] for one in row] == units


def test_a_map_too_large_to_be_solved_has_a_range_alone(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    large = replace(TOY, width=20, height=20, deliveries=16, max_steps=600, battery_capacity=600)
    monkeypatch.setitem(TASKS, large.id, large)
    answer = ask(client, "toy", 1, ["UP"])
    assert "GB are allowed" in answer["unsolved"]
    assert {name for name, value in answer.items() if value is not None} == {"position", "unsolved", "range"}


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
