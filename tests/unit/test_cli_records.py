"""Recorded flights on the command line: saved, flown again, analysed."""

import json
import re
from pathlib import Path

import pytest

from drone_env.analysis import analyse_flight
from drone_env.cli import main
from drone_env.core.state_manager import Episode
from drone_env.episodes.record import load_record, record_of, save_record


@pytest.fixture
def flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A blunder-ridden record."""
    file = tmp_path / "flight.json"
    main(["fly", "--task", "medium", "--agent", "random", "--seed", "7", "--record", str(file)])
    capsys.readouterr()
    return file


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """A record of a flight that stops in the air."""
    episode = Episode("easy")
    episode.reset(7)
    episode.step(4)
    save_record(record_of(episode, "someone"), tmp_path / "stopped.json")
    return tmp_path / "stopped.json"


@pytest.mark.parametrize(
    "options",
    [
        ["--task", "easy", "--agent", "greedy"],
        ["--task", "hard", "--agent", "random", "--reward-profile", "aligned"],
        ["--task", "skyline_easy", "--agent", "optimal"],
    ],
)
def test_a_recorded_flight_replays_to_the_same_log(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "records" / "flight.json"
    assert main(["fly", *options, "--seed", "7", "--record", str(file)]) == 0
    first = capsys.readouterr()
    assert all(line.startswith(("[START]", "[STEP]", "[END]")) for line in first.out.splitlines())
    assert [path.name for path in file.parent.iterdir()] == ["flight.json"]
    assert load_record(file).agent == options[3]
    assert main(["replay", str(file)]) == 0
    again = capsys.readouterr()
    assert again.out == first.out
    assert again.err == first.err.replace(f"record: {file}\n", "")


def test_replay_shows_maps_beside_the_log(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(flight), "--render"]) == 0
    captured = capsys.readouterr()
    assert captured.err.count("🚁") == captured.out.count("[STEP]") + 1 == len(load_record(flight).actions) + 1
    assert "🚁" not in captured.out


def test_replay_of_an_unfinished_flight_counts_the_waiting(stopped: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(stopped)]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines()[-2:] == [
        "[STEP] step=1 action=WAIT reward=0.10 done=false error=null",
        "[END] success=false steps=1 score=0.010 rewards=0.10",
    ]
    assert "unfinished" in captured.err


@pytest.mark.parametrize("command", ["replay", "analyse-flight"])
def test_a_tampered_record_is_refused_before_anything_is_printed(
    command: str, flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = json.loads(flight.read_text())
    flight.write_text(json.dumps(record | {"score": 0.99}))
    assert main([command, str(flight)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "score 0.99 where the flight gives" in captured.err


@pytest.mark.parametrize("command", ["replay", "analyse-flight"])
@pytest.mark.parametrize(("text", "status"), [(None, 2), ("{}", 2), ("not JSON", 2)])
def test_what_is_no_record_is_an_error_that_names_the_file(
    command: str, text: str | None, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "other.json"
    if text is not None:
        file.write_text(text)
    assert main([command, str(file)]) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "other.json" in captured.err


def test_a_flight_is_the_same_recorded_or_flown_first(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options in ([], ["--json"]):
        assert main(["analyse-flight", str(flight), *options]) == 0
        recorded = capsys.readouterr()
        assert main(["analyse-flight", "--task", "medium", "--agent", "random", "--seed", "7", *options]) == 0
        assert capsys.readouterr() == recorded
        assert recorded.err == ""


def test_analyse_flight_prints_only_json_on_request(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse-flight", str(flight), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == analyse_flight(load_record(flight)).to_dict()


def test_analyse_flight_shows_every_move_and_the_summary(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse-flight", str(flight)]) == 0
    out = capsys.readouterr().out
    analysis = analyse_flight(load_record(flight))
    assert out == analysis.to_text() + "\n"
    assert len(re.findall(r"(?m)^ *\d+  [A-Z]+ ", out)) == len(load_record(flight).actions)
    assert analysis.counts["blunder"] > 0
    assert len(re.findall(r"(?m)^ *\d+  [A-Z]+ +\?\? ", out)) == analysis.counts["blunder"]


def test_analyse_flight_colours_blunders_in_a_terminal(
    flight: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert main(["analyse-flight", str(flight)]) == 0
    lines = capsys.readouterr().out.splitlines()
    blunders = [line for line in lines if "?? " in line]
    assert blunders
    assert all(line.startswith("\x1b[1;31m") for line in blunders)
    assert not any("\x1b[1;31m" in line for line in lines if "??" not in line)


def test_analyse_flight_flies_greedy_on_a_map_of_its_own_choice(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse-flight", "--task", "easy"]) == 0
    assert re.match(r"easy_delivery, map \d+, flown by greedy\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["analyse-flight"], "got neither"),
        (["analyse-flight", "--seed", "7"], "got neither"),
        (["analyse-flight", "flight.json", "--task", "easy"], "got both"),
        (["analyse-flight", "flight.json", "--seed", "7"], "without --agent and --seed"),
        (["analyse-flight", "flight.json", "--agent", "greedy"], "without --agent and --seed"),
        (["analyse-flight", "--task", "extreme"], "easy_delivery"),
        (["analyse-flight", "--task", "easy", "--agent", "ace"], "greedy, optimal, pathqnet, random"),
        (["analyse-flight", "--task", "easy", "--agent", ""], "greedy, optimal, pathqnet, random"),
        (["analyse-flight", "--task", ""], "easy_delivery"),
        (["analyse-flight", "--task", "easy", "--seed", "-1"], "[0, 2^53)"),
        (["replay"], "FILE"),
        (["fly", "--record", "."], "--record"),
    ],
)
def test_what_is_not_allowed_exits_2_and_says_what_is(
    arguments: list[str], allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = main(arguments)
    except SystemExit as exit_:
        status = exit_.code
    captured = capsys.readouterr()
    assert status == 2
    assert allowed in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("command", ["replay", "analyse-flight"])
def test_help_is_a_manual(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main([command, "--help"])
    assert exit_.value.code == 0
    out = capsys.readouterr().out
    assert f"Example: drone-env {command}" in " ".join(out.split())
    assert "FILE" in out
