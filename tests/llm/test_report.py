"""Reports and the leaderboard: figures by hand, and runs that are not what they say."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drone_env.cli import main
from drone_env.core.seeds import split_seeds
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, Options
from drone_env.llm.config import Sampling
from drone_env.llm.report import report, run_entry, write_report
from drone_env.llm.run_folder import Run, read_run
from drone_env.llm.runner import summary_lines
from drone_env.llm.sender import TryFailedError
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, evaluation_entries, group_by_maps

from .scripted_server import reply
from .stored_run import Scripted, fly, put_run, run_config


def test_repeats_are_other_draws_from_the_model(tmp_path: Path) -> None:
    # Of four flights over map 14, of three steps each, the second one waits to its end. The first answer is repaired.
    sender = Scripted(lambda number: "WAIT" if 4 <= number < 64 else "greedy")
    flown = fly(sender, tmp_path / "run", repeats=4, sampling=Sampling(seed=5))
    assert [flight.success for flight in flown.result.flights] == [True, False, True, True]
    assert [flight.parameters["seed"] for flight in flown.result.flights] == [5, 6, 7, 8]
    assert report(read_run(tmp_path / "run")).report["success_rate"] == 0.75


def test_a_run_is_invalid_if_more_than_one_flight_in_20_errored() -> None:
    def verdict_of(planned: int, *statuses: str, fatal: str | None = None) -> tuple[str, str]:
        flights: Any = [SimpleNamespace(status=status) for status in statuses]
        return Run(Path(), run_config(repeats=planned), flights, Budget(Options()), fatal).verdict

    assert verdict_of(20, "errored", *["finished"] * 19) == ("valid", "")
    assert verdict_of(19, "errored", *["finished"] * 18)[0] == "invalid"
    assert verdict_of(3, "finished", "finished")[0] == "incomplete"
    assert verdict_of(2, "finished", "budget_stop")[0] == "incomplete"
    assert verdict_of(2, "finished", fatal="no such model") == ("stopped", "no such model")


def test_a_map_counts_once_however_many_of_its_flights_errored(tmp_path: Path) -> None:
    once = fly(Scripted(), tmp_path / "once", seeds=(14, 16))
    sender = Scripted(fails=lambda number: TryFailedError(400, "no") if number == len(once.calls) else None)
    flown = fly(sender, tmp_path / "run", seeds=(14, 16), repeats=2)
    figures = report(read_run(tmp_path / "run")).report
    assert figures["flights"]["errored"] == 1
    assert figures["success_rate"] == 1
    assert summary_lines(flown.result)[0].startswith(f"mean score {figures['score']:.4f} over 3 flights")


def test_errored_flights_are_kept_out_and_shown(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>|x![](http://h)"
    folder, fails = tmp_path / "run", TryFailedError(500, hostile, retried=True)
    fly(Scripted(fails=lambda number: fails if number > 3 else None), folder, seeds=(14, 16), model=hostile)
    found = report(read_run(folder))
    figures = found.report
    assert (figures["verdict"], figures["score"], figures["score_ci95"]) == ("invalid", 0.99, None)
    assert figures["flights"] == {"planned": 2, "flown": 2, "counted": 1, "errored": 1, "unfinished": 0}


def test_a_run_without_a_score_has_a_report(tmp_path: Path) -> None:
    fly(Scripted(fails=lambda _: TryFailedError(400, "no", retried=True)), tmp_path, seeds=(14, 16))
    write_report(report(read_run(tmp_path)))
    assert json.loads((tmp_path / "report.json").read_text())["score"] is None


def test_a_run_that_does_not_follow_from_its_answers_is_refused(tmp_path: Path) -> None:
    folder = put_run(tmp_path, "run", "WAIT", range(14, 16))
    config, calls = ((folder / name).read_text() for name in ("run.json", "calls.jsonl"))
    last = calls.splitlines(keepends=True)[-1]
    for files, told in (
        (
            {"calls.jsonl": calls.replace('"text":"WAIT"', '"text":"LEFT"', 1)},
            "has another request than this run sends",
        ),
        ({"calls.jsonl": calls + last.replace('"turn":60', '"turn":61')}, "flight 1: it has an answer too many"),
        ({"calls.jsonl": calls + last.replace('"flight":1', '"flight":2')}, "flight 2: it has an answer too many"),
        ({"run.json": config.replace('"scripted"', '"better"')}, "call 0-1-1 has another request"),
    ):
        for name, text in {"run.json": config, "calls.jsonl": calls, **files}.items():
            (folder / name).write_text(text)
        with pytest.raises(InvalidValueError, match=told):
            read_run(folder)


def test_a_bad_flight_cannot_be_left_out(tmp_path: Path) -> None:
    folder = put_run(tmp_path, "run", "WAIT", range(14, 16))
    calls = (folder / "calls.jsonl").read_text()
    lines = calls.splitlines(keepends=True)
    for left, reason in ((120, "cut short: 1; not begun: 0"), (61, "cut short: 0; not begun: 1"), (0, "not begun: 2")):
        (folder / "calls.jsonl").write_text("".join(sorted(lines, key=lambda line: '"flight":1' in line)[:left]))
        entry = run_entry(folder)
        assert isinstance(entry, NotRanked)
        assert entry.reason.endswith(reason)


@pytest.mark.parametrize(
    ("usage", "tokens"),
    [
        ([None] * 3, (None, None, None)),
        ([(None, 2)] * 3, (None, 6, 6)),
        ([(100, 2), None, (100, 4)], (200, 6, 206)),
    ],
)
def test_tokens_that_no_answer_reports_are_unknown_not_0(
    usage: list[Any], tokens: tuple[object, ...], tmp_path: Path
) -> None:
    class Metered(Scripted):
        async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
            prompt, completion = usage[int(call_id.split("-")[1]) - 1] or (None, None)
            text = reply("greedy", request["messages"][1]["content"])
            return Answer(text=text, prompt_tokens=prompt, completion_tokens=completion)

    fly(Metered(), tmp_path)
    assert tuple(report(read_run(tmp_path)).report["tokens"].values()) == tokens


def test_the_leaderboard_ranks_whole_runs_and_agents_over_the_same_maps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    agents, elsewhere = tmp_path / "agents", tmp_path / "elsewhere"
    evaluate = ("evaluate", "--task", "easy", "--agents")
    assert main([*evaluate, "random", "greedy", "--repeats", "3", "--seeds", "14:18", "--out", str(agents)]) == 0
    assert main([*evaluate, "greedy", "--seeds", "14:19", "--out", str(elsewhere)]) == 0
    waiting, again = (put_run(tmp_path, name, "WAIT", range(14, 18)) for name in ("waiting", "again"))
    short = tmp_path / "llm" / "short"
    fly(Scripted(), short, Options(concurrency=1, max_calls=5), seeds=(14, 18))
    entries = [run_entry(path) for path in sorted((tmp_path / "llm").iterdir())]
    entries += [entry for path in (agents, elsewhere) for entry in evaluation_entries(path)]
    board, other = group_by_maps(entry for entry in entries if isinstance(entry, LeaderboardEntry))
    assert [board.maps, other.maps] == ["maps 14 to 17 (custom)", "maps 14 to 18 (custom)"]
    assert [row.path for row in board.rows] == [agents, agents, again, waiting]
    assert (board.rows[-1].normalised or 0) < 0 < (board.rows[0].normalised or 0)
    assert [entry.path for entry in entries if isinstance(entry, NotRanked)] == [short]
    # Rows that would look alike show their folders.
    assert main(["leaderboard", str(waiting), str(again)]) == 0
    table = capsys.readouterr().out
    assert "(waiting)" in table
    assert "(again)" in table


def test_runs_can_be_submitted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = split_seeds("test", 20)[0]
    runs, file = [tmp_path / "easy", tmp_path / "skyline_easy"], tmp_path / "model.jsonl"
    for run in runs:
        fly(Scripted(), run, task=run.name, seeds=(first, first + 20))
    submit = ("submit", "--link", "https://example.org", "--out", str(file), "--runs")
    assert main([*submit, *map(str, runs)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "prompt minimal-2, 0.0% of the answers unusable as reported" in shown
    score = json.loads((runs[0] / "episodes.jsonl").read_text().splitlines()[0])["score"]
    assert json.loads(file.read_text().splitlines()[1])["score"] == score
    fly(Scripted(), tmp_path / "other", model="other", seeds=(first, first + 20))
    assert main([*submit, str(runs[0]), str(tmp_path / "other")]) == 2
    assert "other is of another model or prompt than" in " ".join(capsys.readouterr().err.split())


def test_folders_that_cannot_be_ranked_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    killed = put_run(tmp_path, "killed", "WAIT", range(14, 17))
    (killed / "calls.jsonl").unlink()
    (tmp_path / "empty").mkdir()
    for folder, status, told in (
        (killed, 1, f"not ranked: {killed}: incomplete: flights cut short: 0; not begun: 3"),
        (tmp_path / "nowhere", 1, ": no such folder; give a folder of evaluate --out or infer --out"),
        (tmp_path / "empty", 1, "no results in it; give a folder of evaluate --out or infer --out"),
    ):
        assert main(["leaderboard", str(folder)]) == status
        assert told in " ".join(capsys.readouterr().err.split())
