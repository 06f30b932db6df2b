"""Agents and language models on one board, and which evaluations are not ranked."""

import json
from pathlib import Path
from typing import Any

import pytest

from drone_env.cli import main
from tests.llm.stored_run import put_run

MAPS = ("--task", "easy", "--seeds", "14:18")


def evaluated(folder: Path, *options: str) -> Path:
    assert main(["evaluate", *MAPS, *options, "--out", str(folder)]) == 0
    return folder


def ranked(capsys: pytest.CaptureFixture[str], *folders: Path, status: int = 0) -> Any:
    capsys.readouterr()
    assert main(["leaderboard", *map(str, folders), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_only_the_same_maps_stand_on_one_board_and_a_folder_stands_for_all_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agents = evaluated(tmp_path / "agents", "--agents", "random", "greedy", "--repeats", "3")
    model = put_run(tmp_path, "model", "WAIT", range(14, 18))
    elsewhere = tmp_path / "elsewhere"
    assert main(["evaluate", "--task", "easy", "--agents", "greedy", "--seeds", "14:19", "--out", str(elsewhere)]) == 0
    boards = ranked(capsys, agents, model, elsewhere)["boards"]
    assert [board["maps"] for board in boards] == ["maps 14 to 17 (custom)", "maps 14 to 18 (custom)"]
    greedy, _, waits = boards[0]["rows"]
    assert [row["path"] for row in boards[0]["rows"]] == [str(agents), str(agents), str(model)]
    assert waits["normalised"] < 0 < greedy["normalised"]
    assert [len(board["rows"]) for board in ranked(capsys, tmp_path, model.parent)["boards"]] == [3, 1]
    # Rows that would look alike show their folders.
    twice = [str(model), str(put_run(tmp_path, "again", "WAIT", range(14, 18)))]
    assert main(["leaderboard", *twice]) == 0
    table = capsys.readouterr().out
    assert all(f"({Path(folder).name})" in table for folder in twice)


def test_folders_of_other_maps_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    agents = str(evaluated(tmp_path / "agents", "--agents", "random"))
    other = str(put_run(tmp_path, "model", "greedy", range(14, 17)))
    (tmp_path / "empty").mkdir()
    for arguments, told in (
        ((agents,), "compare takes two agents or more"),
        ((agents, other), "folders are compared over the same maps"),
        ((agents, "greedy", "--task", "easy"), "folders name task and maps themselves"),
        ((str(tmp_path / "empty"), "greedy"), "no results in it; give a folder of evaluate --out or infer --out"),
    ):
        assert main(["compare", *arguments]) == 2
        assert told in " ".join(capsys.readouterr().err.split())
