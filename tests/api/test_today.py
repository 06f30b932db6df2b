"""The map of the day and its list, and the names that people choose."""

import re
from datetime import date, datetime, timedelta, timezone
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.actions import Action
from drone_env.core.seeds import SPLITS
from drone_env.flights.provenance import Provenance
from drone_env.planning.optimal import solve
from drone_env.server.daily import DAILY, map_of_the_day
from tests.api.flying import ByHand, directions, flown, label, start

NOON = datetime(2020, 11, 26, 12, tzinfo=timezone.utc)
"""Of a day long ago: flights of the tests end later, whatever the clock of the machine says."""


@pytest.fixture(autouse=True)
def _same_day(monkeypatch: pytest.MonkeyPatch) -> None:  # pyright: ignore[reportUnusedFunction]
    monkeypatch.setattr("drone_env.server.daily.today", NOON.date)


def best(client: TestClient) -> list[tuple[Any, ...]]:
    return [(row["person"], row["score"], row["steps"]) for row in client.get("/today").json()["best"]]


def test_a_day_has_one_map_and_each_task_comes_in_turn() -> None:
    days = [date(2026, 11, 26) + timedelta(days) for days in range(len(DAILY))]
    maps = [map_of_the_day(day) for day in days]
    assert {task for task, _ in maps} == set(DAILY)
    assert [seed for _, seed in maps] == [20261126, 20261127, 20261128]
    assert all(seed in range(SPLITS["train"].start, SPLITS["train"].stop) for _, seed in maps)


def test_the_front_page_flies_the_map_of_the_day(shared_client: TestClient) -> None:
    today = shared_client.get("/today").json()
    assert (today["task"], today["seed"]) == map_of_the_day(NOON)
    (query,) = re.findall(r'href="\?([^"]*)">Map of the day, (?:\d+ \w+)<', shared_client.get("/").text)
    assert query.split("&amp;") == [f"task={today['task']}", f"seed={today['seed']}", "pilot=human"]


def test_the_front_page_flies_yesterdays_map_beside_its_best_flight(client: TestClient) -> None:
    assert "of yesterday" not in client.get("/").text
    task, seed = map_of_the_day(NOON - timedelta(1))
    store = client.app.state.shared.store  # pyright: ignore
    for agent in ("random", "greedy"):
        best = store.add_episode(flown(task, agent, seed=seed), Provenance(pilot="human").named("Ada"))
    ((query, text),) = re.findall(r'href="\?([^"]*)">(Fly against .*?)<', client.get("/").text)
    assert query.split("&amp;") == [f"task={task}", f"seed={seed}", "pilot=human", f"ghost={best}"]
    assert text == f"Fly against the best of yesterday, {100 * flown(task, 'greedy', seed=seed).score:.1f} by Ada"
    assert "of yesterday" not in client.get("/?task=easy").text


def test_the_list_has_the_best_flight_of_each_name_flown_without_help(client: TestClient) -> None:
    today = client.get("/today").json()
    task, seed, store = today["task"], today["seed"], client.app.state.shared.store  # pyright: ignore
    optimum, weak = solve(task, seed), flown(task, "greedy", seed=seed)
    moves = [Action(action).name for action in optimum.actions]
    for name, actions in (("Ada", directions(weak)), ("Ada", moves), ("Grace", moves), (None, moves)):
        # The last move is flown by hand.
        own = {"actions": actions[:-1], "step": 0, "of": {"pilot": "human", "person": "Eve"}}
        (shown,) = start(client, "human", task=task, seed=seed, fork=own, name=name)
        episode = ByHand(client, shown).change(actions[-1])["episode"]
        agent = client.get(f"/episodes/{episode}").json()["agent"]
        assert agent == (f"human ({name})" if name else "human")
    first, unnamed = (optimum.score, optimum.steps), (None, optimum.score, optimum.steps)
    assert best(client) == [("Ada", *first), ("Grace", *first), unnamed]
    human = Provenance(pilot="human")
    helped = (
        Provenance(pilot="human", values_used=True),
        Provenance(pilot="human", person="Bob", undo_used=True),
        human.named("Ada").forked(3, "greedy").forked(5, "human"),
    )
    for agent in (*helped, "optimal", "humans", "human (Bob)", *(human.named(f"n{number}") for number in range(20))):
        store.add_episode(weak, agent)
    store.add_episode(flown(task, "greedy", seed=seed + 1), human.named("Other"))
    assert best(client)[:3] == [("Ada", *first), ("Grace", *first), unnamed]
    assert best(client)[3:] == [(f"n{number}", weak.score, weak.steps) for number in range(7)]
    assert store.best(task, seed, datetime.now(timezone.utc).timestamp() + 60, 10) == []


HOSTILE = [
    "",
    "a" * 21,
    "a b",
    "(Ada",
    "a\n",
    "\u202eada",
    "z\u0335",
    7,
]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_is_one_short_word(shared_client: TestClient, name: object) -> None:
    body = {"task": "easy", "seed": 7, "pilots": ["human"], "name": name}
    assert shared_client.post("/flights", json=body).json()["code"] == "invalid_request"


def test_a_name_is_of_people_alone(shared_client: TestClient) -> None:
    flights = start(shared_client, "greedy", "human", name="Åsa_7-語")
    assert [*map(label, flights)] == ["greedy", "human (Åsa_7-語)"]
    assert flights[1]["opening"]["pilot"] == "human"
