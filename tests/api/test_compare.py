"""Who flies better: the leaderboard, two agents map by map, the runs of language models and what they were asked."""

import json
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from statistics import mean
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.flights.provenance import Provenance
from drone_env.flights.store import Store
from drone_env.llm.run_folder import TRANSCRIPT
from drone_env.llm.transcript import read_calls
from drone_env.planning.optimal import solve
from drone_env.results.evaluate import evaluate
from drone_env.results.folder import SHIPPED, EvaluationConfig
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.browser.flights import fill, flown
from tests.llm.stored_run import put_run

TASK = "easy_delivery"
FORK = "human from step 2 of greedy"
BY = {
    "human with values": Provenance(pilot="human", values_used=True),
    FORK: Provenance(pilot="greedy").forked(2, "human"),
}
LABELS = [
    *[("greedy", seed, "greedy") for seed in range(6)],
    *[("random", seed, "random") for seed in range(2, 9)],
    # Two over one map, of which one goes wrong.
    *[("greedy", 4, "human with values"), ("random", 4, "human with values"), ("greedy", 5, "human with values")],
    ("optimal", 3, "somebody else"),
    ("optimal", 3, FORK),
]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with flights by several agents and runs of language models, one of them over another task."""
    folder = tmp_path_factory.mktemp("compared") / "data"
    fill(folder, [flown("easy", seed, agent, BY.get(label, label)) for agent, seed, label in LABELS])
    fill(folder, [flown("medium", 3, "greedy")])
    put_run(folder, "good", "greedy", range(14, 16), repeats=2)
    put_run(folder, "bad", "WAIT", range(14, 16), model="scripted/waits")
    put_run(folder, "elsewhere", "greedy", range(3, 4), task="medium")
    forged = put_run(folder, "forged", "WAIT", range(14, 15), model="scripted/lies") / TRANSCRIPT
    forged.write_text(forged.read_text().replace('"text":"WAIT"', '"text":"LEFT"', 1))
    return folder


@pytest.fixture(scope="module")
def client(data: Path) -> Generator[TestClient, None, None]:
    with TestClient(create_app(Settings(data=data))) as running:
        yield running


@pytest.fixture(scope="module")
def flights(data: Path) -> dict[str, dict[int, list[Any]]]:
    """The flights over easy maps by agent and map, oldest first."""
    found: dict[str, dict[int, list[Any]]] = defaultdict(lambda: defaultdict(list))
    with Store(data) as store:
        for episode in store.episodes():
            if episode.record.task == TASK:
                found[episode.record.agent][episode.record.seed].append(episode)
    return found


def get(client: TestClient, path: str, **query: str) -> Any:
    return client.get(path, params=query).raise_for_status().json()


def test_the_leaderboard_counts_each_map_once(client: TestClient, flights: dict[str, dict[int, list[Any]]]) -> None:
    answer = get(client, "/leaderboard/easy")
    rows = {row["agent"]: row for row in answer["rows"]}
    assert rows.keys() == flights.keys() - {FORK}
    assert (answer["task"], answer["forks"]) == (TASK, 1)
    assert [row["regret"] for row in answer["rows"]] == sorted(row["regret"] for row in rows.values())
    mine, maps = rows["human with values"], flights["human with values"]
    assert (mine["flights"], mine["maps"], mine["regret_maps"], mine["success_rate"]) == (3, 2, 2, 0.75)
    assert mine["score"] == pytest.approx(mean(mean(one.record.score for one in of_map) for of_map in maps.values()))
    assert [Provenance.model_validate(row["by"]).label for row in rows.values()] == list(rows)


def test_an_agents_maps_are_those_that_it_flew(client: TestClient, flights: dict[str, dict[int, list[Any]]]) -> None:
    answer = get(client, "/leaderboard/easy/maps", agent="human with values")
    assert [(row["seed"], row["optimum"], row["id"], row["flights"]) for row in answer["maps"]] == [
        (seed, solve("easy", seed).score, of_map[-1].id, len(of_map))
        for seed, of_map in sorted(flights["human with values"].items())
    ]


def test_whom_nobody_knows_is_told_with_those_who_flew(client: TestClient) -> None:
    for path in ("/paired/easy?a=greedy&b=nobody", "/leaderboard/easy/maps?agent=nobody"):
        answer = client.get(path)
        assert (answer.status_code, answer.json()["code"]) == (404, "unknown_name")
        assert "greedy" in answer.json()["detail"]


def test_two_who_share_no_map_have_no_difference(client: TestClient) -> None:
    alone = get(client, "/paired/easy", a="somebody else", b="scripted")
    assert (alone["maps"], alone["difference"], alone["ci95"], alone["pairs"]) == (0, None, None, [])


def test_runs_of_models_are_ranked_by_the_flights_that_they_can_show(
    client: TestClient, data: Path, flights: dict[str, dict[int, list[Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = get(client, "/leaderboard/easy/runs")
    board, shipped = answer["boards"]
    assert [(row["run"], row["kind"], row["agent"], row["flights"]) for row in board["rows"]] == [
        ("good", "model", "scripted", 4),
        ("bad", "model", "scripted/waits", 2),
    ]
    assert all(row["shipped"] for row in shipped["rows"])
    of_model = get(client, "/leaderboard/easy/maps", agent="scripted", run="good")["maps"]
    assert [(of_map["seed"], of_map["flights"], of_map["id"]) for of_map in of_model] == [
        (seed, 2, flights["scripted"][seed][-1].id) for seed in (14, 15)
    ]
    (unranked,) = answer["unranked"]
    assert unranked["run"] == "forged"
    assert "has another request than this run sends" in unranked["reason"]
    assert str(data) not in json.dumps(answer)
    # What has been checked is not checked again.
    monkeypatch.setattr("drone_env.llm.report.read_run", None)
    assert get(client, "/leaderboard/easy/runs") == answer


def test_shipped_results_are_those_of_the_agents_map_by_map(client: TestClient) -> None:
    run = f"drone-env {EvaluationConfig.load(SHIPPED).package}"
    (board,) = get(client, "/leaderboard/skyline_easy/runs")["boards"]
    assert {row["agent"] for row in board["rows"]} >= {"random", "greedy", "tournet", "optimal"}
    assert {(row["run"], row["kind"], row["maps"], row["shipped"]) for row in board["rows"]} == {
        (run, "agent", 1000, True)
    }
    maps = get(client, "/leaderboard/skyline_easy/maps", agent="tournet", run=run)["maps"]
    flown_again = evaluate("tournet", "skyline_easy", "test", 20)
    assert [(of_map["seed"], of_map["score"], of_map["optimum"], of_map["steps"]) for of_map in maps[:20]] == [
        (row.seed, row.score, row.optimum, row.steps) for row in flown_again.rows()
    ]
    assert {of_map["id"] for of_map in maps} == {None}
    pair = get(client, "/paired/skyline_easy", a="tournet", b="optimal", run_a=run, run_b=run)
    assert (pair["maps"], pair["wins"]) == (1000, 0)
    answer = client.get("/leaderboard/skyline_easy/maps", params={"agent": "tournet", "run": "nobody's"})
    assert (answer.status_code, run in answer.json()["detail"]) == (404, True)


def test_a_models_flight_has_its_prompts_and_answers_by_step(
    client: TestClient, data: Path, flights: dict[str, dict[int, list[Any]]]
) -> None:
    first = next(one for one in flights["scripted"][14] if one.record.success)
    answer = get(client, f"/episodes/{first.id}/calls")
    assert answer["model"] == "scripted"
    calls = [call for call in read_calls(data / "llm" / "good" / "calls.jsonl") if call.flight == 0]
    first_calls = [(call["turn"], call["attempt"], call["outcome"]) for call in answer["calls"]][:3]
    assert first_calls == [(1, 1, "illegal"), (1, 2, "ok"), (2, 1, "ok")]
    assert answer["calls"] == [call.model_dump() for call in calls]
    none = get(client, f"/episodes/{flights['greedy'][0][0].id}/calls")
    assert none == {"model": None, "calls": []}


def test_a_run_that_is_damaged_or_has_just_begun_stops_nothing(tmp_path: Path) -> None:
    path = put_run(tmp_path, "cut", "greedy", range(14, 16))
    with Store(tmp_path) as store:
        flight = store.listed(1)[0].id
    (tmp_path / "llm" / "unread").mkdir()
    (tmp_path / "llm" / "unread" / "run.json").write_text("{}")
    with TestClient(create_app(Settings(data=tmp_path))) as client:
        assert [one["run"] for one in get(client, "/leaderboard/easy/runs")["unranked"]] == ["unread"]
        calls = path / "calls.jsonl"
        calls.write_text(calls.read_text() + "no call\n")
        cut, _ = get(client, "/leaderboard/easy/runs")["unranked"]
        assert "of cut/calls.jsonl is no call" in cut["reason"]
        assert get(client, f"/episodes/{flight}/calls")["calls"] == []
        # As it is before its first call.
        calls.unlink()
        assert get(client, f"/episodes/{flight}/calls")["calls"] == []
