"""Recorded flights on the command line: saved, flown again, analysed."""

import json
import re
from pathlib import Path

import pytest

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.flights.record import load_record, record_of, save_record
from drone_env.flights.store import Store
from drone_env.results.analysis import analyse_flight


@pytest.fixture
def flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A blunder-ridden record."""
    file = tmp_path / "flight.json"
    main(["fly", "--task", "medium", "--agent", "random", "--seed", "7", "--record", str(file)])
    capsys.readouterr()
    return file


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
    assert main(["analyse-flight", str(stopped)]) == 0
    assert "Unfinished after 2 steps: counted as if it had waited to the end" in capsys.readouterr().out


def test_a_flight_is_the_same_recorded_or_flown_first(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    analysis = analyse_flight(load_record(flight))
    as_json = json.dumps(analysis.to_dict(), indent=2)
    flown = "--task", "medium", "--agent", "random", "--seed", "7"
    for options, shown in (([], "best moves of"), (["--json"], f"{as_json}\n")):
        assert main(["analyse-flight", str(flight), *options]) == 0
        recorded = capsys.readouterr()
        assert shown in recorded.out
        assert main(["analyse-flight", *flown, *options]) == 0
        assert capsys.readouterr() == recorded


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
    spoil(flights, 2, deliveries=2)
    assert main(["replay", str(flights)]) == 2
    captured = capsys.readouterr()
    assert captured.out.count("[START]") == captured.out.count("[END]") == 1
    assert "deliveries 2 where the flight gives" in captured.err
    flights.write_bytes(flights.read_bytes()[:-100])
    assert main(["replay", str(flights), "--verify"]) == 2
    assert "line 3 of" in capsys.readouterr().err


def test_verify_says_it_of_every_line(flights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(flights), "--verify"]) == 0
    line = r"verified: line \d of .*flights.jsonl: easy_delivery map \d, \d+ rewards, score 0\.\d+\n"
    assert re.fullmatch(f"({line}){{3}}", capsys.readouterr().out)
    spoil(flights, 2, rewards=[0.5] * 60)
    assert main(["replay", str(flights), "--verify"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["verified", "wrong", "verified"]
    assert "reward 0.5 of step 1 where the flight pays" in lines[1]
    spoil(flights, 2, task_version=9)
    assert main(["replay", str(flights), "--verify"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["verified", "unknown", "verified"]


def test_replay_of_a_stored_episode(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DRONE_ENV_DATA", str(tmp_path / "kept"))
    with Store(tmp_path / "kept") as store:
        episode_id = store.add_episode(load_record(flight))
    assert main(["replay", episode_id, "--verify"]) == 0
    assert f"verified: episode {episode_id}: medium_delivery map 7" in capsys.readouterr().out
    assert main(["replay", "0123456789abcdef"]) == 2
    assert capsys.readouterr().err == "drone-env: there is no episode '0123456789abcdef'\n"
    monkeypatch.setenv("DRONE_ENV_DATA", str(tmp_path / "none"))
    assert main(["replay", "0123456789abcdef"]) == 2
    assert "DRONE_ENV_DATA" in capsys.readouterr().err
