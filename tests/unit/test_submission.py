"""Submissions to the leaderboard: what passes, what does not, and our own."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from drone_env.agents import SHIPPED_AGENTS
from drone_env.cli import main
from drone_env.core.seeds import split_seeds
from drone_env.results.evaluate import episodes_key
from drone_env.results.folder import shipped_results
from tests.tools import ROOT

FIRST = split_seeds("test", 20)[0]
Lines = list[str]


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Lines:
    """A submission of `greedy`: lines 2 to 21 are easy, 22 to 41 skyline_easy."""
    file = tmp_path_factory.mktemp("submission") / "leaderboard" / "greedy.jsonl"  # a folder to make
    options = ["--agent", "greedy", "--name", "rule", "--link", "https://example.org", "--maps", "20"]
    assert main(["submit", *options, "--task", "easy", "skyline_easy", "--out", str(file)]) == 0
    return file.read_text(encoding="utf-8").splitlines()


def test_a_submission_passes_and_shows_its_entry(
    lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert main(["verify", str(tmp_path / "a.jsonl")]) == 0
    entry, shown = " ".join(capsys.readouterr().out.split()), []
    assert main(["evaluate", "--task", "easy", "skyline_easy", "--agents", "greedy", "--episodes", "20"]) == 0
    for line in capsys.readouterr().out.splitlines():
        if " greedy " in line:
            shown.append(" ".join(line.replace(" greedy ", " rule ").split()))
    assert [line in entry for line in shown] == [True, True]
    assert "https://example.org" in entry


def changed(number: int, field: str, value: object) -> Callable[[Lines], Lines]:
    def change(lines: Lines) -> Lines:
        row = json.loads(lines[number - 1]) | {field: value}
        return [*lines[: number - 1], json.dumps(row), *lines[number:]]

    return change


def another_action(lines: Lines) -> Lines:
    """Turn the first action of the first flight, without a change of the score if it stays what it was."""
    actions = json.loads(lines[1])["actions"]
    return changed(2, "actions", ("U" if actions[0] == "D" else "D") + actions[1:])(lines)


FORGED: dict[str, tuple[Callable[[Lines], Lines], str]] = {
    "score": (changed(5, "score", 0.99), r"line 5 of .* does not fit its flight: score: 0.99 is now 0\.97"),
    "action": (another_action, r"line 2 of .*( does not fit its flight|: the flight ends)"),
    "illegal action": (changed(7, "actions", "UX"), r"line 7 of .* is not a flight: actions: String should match"),
    "later actions": (changed(3, "actions", "U" * 61), r"line 3 of .*: the flight ends after \d+ steps, but .* 61 act"),
    "foreign map": (changed(4, "seed", 7), rf"line 4 of .* is easy_delivery map 7, not easy_delivery map {FIRST + 2}:"),
    "other task": (changed(4, "task", "skyline_easy"), r"line 4 of .* is skyline_easy map \d+, not easy_delivery map"),
    "doubled map": (
        lambda all_: [*all_[:9], all_[8], *all_[9:]],
        rf"line 10 of .* map {FIRST + 7}, not .* {FIRST + 8}",
    ),
    "map left out": (
        lambda all_: [*all_[:9], *all_[10:]],
        rf"line 10 of .* map {FIRST + 9}, not .* {FIRST + 8}: .* 20",
    ),
    "fewer maps": (lambda all_: all_[:-1], rf"ends too early: skyline_easy map {FIRST + 19} is missing"),
    "cut": (lambda all_: [*all_[:-1], all_[-1][:-30]], r"line 41 of .* is not a flight: Invalid JSON"),
    "longer": (lambda all_: [*all_, all_[-1]], r"line 42 of .* is one too many"),
    "few maps": (
        changed(1, "maps", 19),
        r"line 1 of .* is not the head of a submission: maps: .* greater than or equal",
    ),
    "more maps": (changed(1, "maps", 21), rf"line 22 of .* is skyline_easy .*, not easy_delivery map {FIRST + 20}"),
    "version": (changed(1, "tasks", {"easy_delivery": 9}), r"unknown .*easy_delivery.* 9"),
    "no link": (changed(1, "link", "javascript:alert(1)"), r"line 1 of .*: link: String should match"),
    "empty": (lambda _: [], r"line 1 of .* is not the head of a submission"),
}


@pytest.mark.parametrize(("forge", "message"), FORGED.values(), ids=FORGED)
def test_a_forged_submission_does_not_pass(
    forge: Callable[[Lines], Lines], message: str, lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.jsonl").write_text("\n".join(forge(lines)) + "\n", encoding="utf-8")
    assert main(["verify", str(tmp_path / "a.jsonl")]) == 2
    assert re.search(message, " ".join(capsys.readouterr().err.split()))


def test_our_submissions_are_of_the_present_agents() -> None:
    for file in sorted((ROOT / "leaderboard").glob("*.jsonl")):
        head, *flights = map(json.loads, file.read_text(encoding="utf-8").splitlines())
        if head["agent"] not in SHIPPED_AGENTS:
            continue
        maps = split_seeds("test", head["maps"])
        shipped = [shipped_results(episodes_key(task, head["agent"], maps, "test")) for task in head["tasks"]]
        scores = [score for results in shipped if results is not None for score in results.scores.tolist()]
        assert scores == [flight["score"] for flight in flights], "run tools/docs_generate.py leaderboard"
