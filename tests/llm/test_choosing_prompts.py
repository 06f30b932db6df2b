"""Which prompt a run asks by: one that lets think, one of your own, several beside each other, that of an old run."""

import json
from collections.abc import Callable
from pathlib import Path
from statistics import fmean

import pytest

from drone_env.core.seeds import SPLITS
from drone_env.planning.optimal import solve
from drone_env.results.statistics import DIFFERENCES, ci95

from .conftest import Endpoint, verified

Start = Callable[..., Endpoint]
OWN = """
format = 1
plan = false
marks = ["MOVE:"]
system = '{% include "rules-2.j2" %}'
user = '{% include "drone-2.j2" %}'
repair = "{{ reason }}"
"""


def test_a_model_may_think_aloud(endpoint: Start) -> None:
    done = endpoint(pilot="aloud").infer("--task", "medium", "--episodes", "2", "--prompt", "think")
    assert (done.status, set(done.turns)) == (0, {"ok"}), done.err
    start = SPLITS["test"].start
    assert [flight["score"] for flight in done.flights] == [solve("medium", start + i).score for i in range(2)]
    verified(done)


def test_a_prompt_of_ones_own_goes_into_the_run(endpoint: Start) -> None:
    scripted = endpoint(pilot="MOVE: LEFT")
    mine = scripted.folder / "mine.toml"
    mine.write_text(OWN)
    first = scripted.infer("--seeds", "14:15", "--prompt", str(mine), "--max-calls", "2")
    assert (first.turns, first.status) == ({"ok": 2, "budget_stop": 1}, 3), first.err
    config = json.loads((first.folder / "run.json").read_text())
    assert (config["prompt"], config["prompt_text"]) == ("mine", OWN)
    assert scripted.requests()[0]["body"]["messages"][0]["content"].startswith("The grid is 10 x 10:")
    # Another file is another run; without one, it goes on with its own.
    mine.write_text(OWN.replace("{{ reason }}", "Again!"))
    again = ("--seeds", "14:15", "--resume", "--max-calls", "5")
    refused = scripted.infer(*again, "--prompt", str(mine), folder=first.folder)
    assert (refused.status, "prompt_digest: " in refused.err) == (2, True)
    mine.unlink()
    resumed = scripted.infer(*again, folder=first.folder)
    assert resumed.turns == {"ok": 5, "budget_stop": 1}
    verified(resumed)


def test_prompts_beside_each_other_in_one_report(endpoint: Start) -> None:
    scripted = endpoint(pilot="able")
    prices = ("--price-prompt", "10", "--price-completion", "50")
    # On two of these maps the nearest parcel is not the best one to begin with.
    fly = ("--task", "medium", "--seeds", "57:60", "--repeats", "2", "--report", "--no-moves", *prices)
    done = scripted.infer(*fly, "--prompts", "coordinates", "original")
    assert done.status == 0, done.err
    single = [json.loads((done.folder / name / "report.json").read_text()) for name in ("coordinates-2", "original-1")]
    report = json.loads((done.folder / "report.json").read_text())
    perfect, greedy = report["runs"]
    scores = [[sum(of_map["scores"]) / 2 for of_map in run["maps"]] for run in single]
    assert [run["score"] for run in report["runs"]] == [run["score"] for run in single]
    assert (perfect["difference"], perfect["difference_ci95"]) == (0, [0, 0])
    less = [ours - theirs for theirs, ours in zip(*scores, strict=True)]
    assert sum(less) < 0
    assert (greedy["maps"], greedy["difference"]) == (3, pytest.approx(fmean(less), abs=1e-12))
    assert greedy["difference_ci95"] == pytest.approx(ci95(less, DIFFERENCES))
    # A call is 100 tokens of prompt and 2 of answer; each map is flown twice.
    calls, points = single[1]["calls"]["answered"], 2 * sum(scores[1])
    assert greedy["tokens_per_point"] == pytest.approx(102 * calls / points)
    assert f"| {greedy['score']:.4f} ± " in (done.folder / "report.md").read_text()
    assert f"original-1: score {greedy['score']:.4f} ± " in done.err
    # What was flown is not paid again, and a prompt that is new is flown.
    asked = len(scripted.requests())
    more = scripted.infer(*fly, "--prompts", "coordinates", "original", "plan", "--resume", folder=done.folder)
    assert [run["prompt"] for run in json.loads((more.folder / "report.json").read_text())["runs"]][2] == "plan-2"
    assert len(scripted.requests()) == asked + 6


def test_prompts_that_cannot_be_compared_are_refused(endpoint: Start, tmp_path: Path) -> None:
    scripted = endpoint(pilot="greedy")
    for arguments, why in (
        (("--prompts", "grid", "plan", "--prompt", "grid"), "give it without --prompt"),
        (("--prompts", "grid", "plan", "--resume"), "there is no run in "),
        (("--prompt", str(tmp_path / "none.toml")), "none.toml"),
    ):
        done = scripted.infer("--seeds", "14:15", *arguments)
        assert (done.status, why in done.err) == (2, True), done.err
    assert scripted.requests() == []
