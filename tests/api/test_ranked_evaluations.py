"""Evaluations that lie in the data folder of a server: agents on the boards of language models."""

import json
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.cli import main
from drone_env.episodes.by_map import FlownMap
from drone_env.evaluation.leaderboard import Refused
from drone_env.server import evaluations
from drone_env.server.app import create_app
from drone_env.server.routes import runs
from drone_env.server.settings import Settings
from tests.browser.flights import put_evaluation
from tests.llm.kept_run import put_run

MAPS = range(14, 18)


def boards(data: Path, task: str = "easy") -> Any:
    with TestClient(create_app(Settings(data=data))) as client:
        answer = client.get(f"/leaderboard/{task}/runs")
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_agents_and_models_stand_on_one_board_as_the_command_ranks_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = put_run(tmp_path, "model", "WAIT", MAPS)
    folders = [put_evaluation(tmp_path, agent, agent, MAPS, repeats=2) for agent in ("random", "greedy")]
    put_evaluation(tmp_path, "elsewhere", "greedy", range(3, 4), task="medium")
    assert main(["leaderboard", *map(str, (model, *folders)), "--json"]) == 0
    (ranked,) = json.loads(capsys.readouterr().out)["boards"]
    answer = boards(tmp_path)
    (board,) = answer["boards"]
    assert (board["maps"], answer["unranked"]) == (ranked["maps"], [])
    assert [(row["agent"], row["kind"], row["run"]) for row in board["rows"]] == [
        ("greedy", "agent", "greedy"),
        ("random", "agent", "random"),
        ("scripted", "model", "model"),
    ]
    for row, expected in zip(board["rows"], ranked["rows"], strict=True):
        for name in ("score", "score_ci95", "normalised", "regret", "success_rate"):
            assert row[name] == expected[name]
        assert [(of["seed"], of["flights"], of["optimum"]) for of in row["maps"]] == [
            (of["seed"], len(of["scores"]), of["optimum"]) for of in expected["maps"]
        ]
    _, random, scripted = board["rows"]
    of_models = ("prompt", "errored", "waits", "unusable_share", "tokens")
    assert (random["flights"], *(random[name] for name in of_models)) == (8, *[None] * 5)
    assert [of["id"] for of in random["maps"]] == [None] * 4
    assert scripted["tokens"] > 0
    assert all(of["id"] for of in scripted["maps"])
    assert [row["agent"] for row in boards(tmp_path, "medium")["boards"][0]["rows"]] == ["greedy"]
    assert boards(tmp_path, "hard") == {"task": "hard_delivery", "boards": [], "unranked": []}


def test_an_evaluation_is_looked_at_again_when_its_files_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = put_evaluation(tmp_path, "mine", "random", MAPS, repeats=2)
    looked: list[Path] = []
    judge = evaluations.judge_evaluation

    def counted(path: Path, *options: Any) -> Any:
        looked.append(path)
        return judge(path, *options)

    monkeypatch.setattr(evaluations, "judge_evaluation", counted)
    kept = evaluations.Evaluations(tmp_path / "evaluations")
    first, again = (kept.judge(folder, "easy_delivery") for _ in range(2))
    assert (first, looked) == (again, [folder])
    next((folder / "pieces").glob("*again1*")).unlink()
    (refused,) = kept.judge(folder, "easy_delivery")
    assert isinstance(refused, Refused)
    assert refused.reason == "1 of 1 pieces of random on easy_delivery are not flown yet"


def test_where_files_lie_is_not_told(tmp_path: Path) -> None:
    folder = put_evaluation(tmp_path, "mine", "random", MAPS)
    config = folder / "evaluation.json"
    config.write_text(config.read_text().replace("random on", "/home/me/model.zip:FlatObservation on"))
    assert boards(tmp_path)["boards"][0]["rows"][0]["agent"] == "model.zip:FlatObservation"
    (piece,) = (folder / "pieces").iterdir()
    piece.write_bytes(b"no piece")
    damaged = boards(tmp_path)["unranked"][0]["reason"]
    piece.unlink()
    missing = boards(tmp_path)["unranked"][0]["reason"]
    assert damaged.startswith("mine/pieces/easy_delivery-v1-")
    assert missing.startswith("1 of 1 pieces of model.zip:FlatObservation on")


def test_an_evaluation_of_too_many_maps_is_not_looked_at(tmp_path: Path) -> None:
    folder = put_evaluation(tmp_path, "mine", "random", MAPS)
    config = folder / "evaluation.json"
    told = json.loads(config.read_text())
    config.write_text(json.dumps({**told, "seeds": [0, 20_000]}))
    (unranked,) = boards(tmp_path)["unranked"]
    assert unranked["reason"] == "20000 maps are more than the 10000 that are looked at here"


def test_of_many_maps_those_where_most_was_lost_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "LISTED", 2)
    rows = [
        FlownMap("me", "easy_delivery", 1, seed, 1, None, score, 0, 9, 0, None, True, 0.95)
        for seed, score in enumerate((0.9, 0.2, 0.8, 0.1))
    ]
    assert runs._listed(rows) == [rows[1], rows[3]]
