"""Recorded flights on the command line: saved and flown again."""

import json
from pathlib import Path

import pytest

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.flights.record import record_of, save_record


def test_a_recorded_flight_replays_to_the_same_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "records" / "flight.json"
    options = ["--task", "hard", "--agent", "random", "--reward-profile", "aligned", "--seed", "7"]
    assert main(["fly", *options, "--record", str(file)]) == 0
    first = capsys.readouterr()
    assert all(line.startswith(("[START]", "[STEP]", "[END]")) for line in first.out.splitlines())
    assert main(["replay", str(file)]) == 0
    again = capsys.readouterr()
    assert again.out == first.out
    assert again.err == first.err.replace(f"record: {file}\n", "")


def test_an_unfinished_flight_is_shown_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stopped = tmp_path / "stopped.json"
    save_record(record_of(Episode("easy", "tiered", 7).fly([4, 4]), "someone"), stopped)
    assert main(["replay", str(stopped)]) == 0
    captured = capsys.readouterr()
    assert captured.out.endswith("[END] success=false steps=2 score=0.010 rewards=0.10,0.10\n")
    assert "unfinished" in captured.err


@pytest.fixture
def flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A JSONL file of three flights."""
    file = tmp_path / "flights.jsonl"
    for seed in (7, 8, 9):
        assert main(["fly", "--agent", "random", "--seed", str(seed), "--record", str(file)]) == 0
    capsys.readouterr()
    return file


def spoil(file: Path, line: int, **fields: object) -> None:
    lines = file.read_text().splitlines()
    lines[line - 1] = json.dumps(json.loads(lines[line - 1]) | fields)
    file.write_text("\n".join(lines) + "\n")


def test_replay_stops_at_the_first_line_that_does_not_fit(flights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(flights)]) == 0
    assert capsys.readouterr().out.count("[END]") == 3
    for fields, wrong in (
        ({"deliveries": 2}, "deliveries 2 where the flight gives"),
        ({"rewards": [0.5] * 60}, "reward 0.5 of step 1 where the flight pays"),
        ({"task_version": 9}, "unknown"),
    ):
        spoil(flights, 2, **fields)
        assert main(["replay", str(flights)]) == 2
        captured = capsys.readouterr()
        assert captured.out.count("[START]") == captured.out.count("[END]") == 1
        assert wrong in captured.err
    flights.write_bytes(flights.read_bytes()[:-100])
    assert main(["replay", str(flights)]) == 2
    assert "line 2 of" in capsys.readouterr().err
