"""Reports and the leaderboard: figures by hand, and runs that are not what they say."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from drone_env.cli import main
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Options
from drone_env.llm.report import report, write_report
from drone_env.llm.runner import verdict_of
from drone_env.llm.verify import verified_run
from drone_env.results.record import EpisodeRecord, record_of

from .conftest import Start
from .scripted_server import reply
from .stored_run import Scripted, fly, put_run


def test_pass_hat_k_is_the_chance_that_k_flights_all_deliver(endpoint: Start) -> None:
    # Of four flights over map 14, of three steps each, the second one waits to its end.
    waiting = {"sends": json.dumps({"choices": [{"message": {"content": "WAIT"}, "finish_reason": "stop"}]})}
    scripted = endpoint(pilot="greedy", faults=[[3, 62, waiting]])
    four = ("--seeds", "14:15", "--repeats", "4", "--concurrency", "1", "--sampling-seed", "5")
    done = scripted.infer(*four)
    assert [flight["success"] for flight in done.flights] == [True, False, True, True]
    # Each flight is another draw from the model.
    seeds = [5] * 3 + [6] * 60 + [7] * 3 + [8] * 3
    assert [request["body"]["seed"] for request in scripted.requests()] == seeds
    assert [call["sampling_seed"] for call in done.calls] == seeds
    figures = report(verified_run(done.folder), moves=False)
    assert figures["pass_hat_k"] == pytest.approx({"1": 3 / 4, "2": 3 / 6, "3": 1 / 4, "4": 0})
    assert figures["success_rate"] == 0.75


def test_a_wait_that_the_model_did_not_choose_is_none_of_its_moves(endpoint: Start) -> None:
    # Of three steps, the second and its retry are unusable.
    nothing = {"sends": json.dumps({"choices": [{"message": {"content": "Hm."}, "finish_reason": "stop"}]})}
    waited = endpoint(pilot="greedy", faults=[[1, 2, nothing]]).infer("--seeds", "14:15")
    moves = report(verified_run(waited.folder))["moves"]
    assert (waited.flights[0]["waits"], sum(moves["labels"].values())) == (1, 3)
    assert (moves["decisive"], moves["accuracy"]) == (3, 1.0)
    moves = report(verified_run(endpoint(pilot="Hm.").infer("--seeds", "14:15").folder))["moves"]
    assert (set(moves["labels"].values()), moves["decisive"], moves["accuracy"]) == ({0}, 0, None)


def test_a_run_is_invalid_if_more_than_one_flight_in_20_errored() -> None:
    assert verdict_of(20, ["errored"] + ["finished"] * 19) == ("valid", "")
    assert verdict_of(19, ["errored"] + ["finished"] * 18)[0] == "invalid"
    assert verdict_of(3, ["finished"] * 2)[0] == "incomplete"
    assert verdict_of(2, ["finished", "budget_stop"])[0] == "incomplete"
    assert verdict_of(2, ["finished"], "no such model") == ("stopped", "no such model")


def test_a_map_counts_once_however_many_of_its_flights_errored(endpoint: Start) -> None:
    # Map 14 takes 3 steps: the second flight over it fails at its first call.
    first = endpoint(pilot="greedy").infer("--seeds", "14:16", "--concurrency", "1")
    calls = len(first.calls)
    scripted = endpoint(pilot="greedy", faults=[[calls, calls, {"status": 400}]])
    done = scripted.infer("--seeds", "14:16", "--repeats", "2", "--concurrency", "1")
    figures = report(verified_run(done.folder), moves=False)
    assert figures["flights"]["errored"] == 1
    assert figures["score"] == pytest.approx(figures["baselines"]["greedy"], abs=1e-12)
    assert figures["pass_hat_k"] == {"1": 1.0}
    assert f"mean score {figures['score']:.4f} over 3 flights" in done.err


def test_errored_flights_are_kept_out_and_shown_and_names_from_elsewhere_stay_text(endpoint: Start) -> None:
    hostile = "<script>alert(1)</script>|x![](http://h)"
    scripted = endpoint(pilot="greedy", faults=[[3, 10**9, {"status": 500, "message": hostile}]])
    done = scripted.infer("--seeds", "14:16", "--concurrency", "1", "--tries", "2", "--model", hostile)
    assert (done.status, done.turns, len(scripted.requests())) == (1, {"ok": 3, "api_error": 1}, 3 + 2)
    run = verified_run(done.folder)
    figures = report(run)
    assert (figures["verdict"], figures["score"], figures["score_ci95"]) == ("invalid", 0.99, None)
    assert figures["flights"] == {"planned": 2, "flown": 2, "counted": 1, "errored": 1, "unfinished": 0}
    assert [of_map["seed"] for of_map in figures["maps"]] == [14]
    write_report(run, figures)
    text = (done.folder / "report.md").read_text()
    assert "<script" not in text
    assert "| 15 | 1 | errored | 500: &lt;script>alert(1)&lt;/script>&#124;x!&#91;](http://h) |" in text


def test_the_leaderboard_ranks_whole_runs_and_names_the_others(
    endpoint: Start, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    greedy = endpoint(pilot="greedy").infer("--seeds", "14:16").folder
    waiting = endpoint(pilot="WAIT").infer("--seeds", "14:16").folder
    short = endpoint(pilot="greedy").infer("--seeds", "14:16", "--max-calls", "4", "--concurrency", "1").folder
    capfd.readouterr()
    twice = str(greedy / ".." / greedy.name)
    assert main(["leaderboard", str(waiting), str(short), str(greedy), twice, "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    (board,) = found["boards"]
    assert [row["path"] for row in board["rows"]] == [str(greedy), str(waiting)]
    assert [run["path"] for run in found["refused"]] == [str(short)]
    for name in ("episodes.jsonl", "flights.jsonl"):
        (short / name).unlink()
    # Such a run is no forged one.
    assert main(["leaderboard", str(short)]) == 0
    assert f"not ranked: {short}: no flights yet: it is running, or was killed" in capfd.readouterr().err
    (tmp_path / "empty").mkdir()
    for name, why in (("nowhere", "no such folder"), ("empty", "no results in it")):
        assert main(["leaderboard", str(tmp_path / name)]) == 1
        assert f": {why}; give a folder of evaluate --out or infer --out\n" in capfd.readouterr().err


def test_a_run_that_does_not_follow_from_its_answers_is_refused(tmp_path: Path) -> None:
    folder = put_run(tmp_path, "run", "WAIT", range(14, 16))
    whole = {
        name: (folder / name).read_text() for name in ("run.json", "calls.jsonl", "episodes.jsonl", "flights.jsonl")
    }
    _, calls, records, results = whole.values()
    first, second = records.splitlines(keepends=True)
    start, last = calls[: calls.rindex("\n", 0, -1) + 1], calls.splitlines(keepends=True)[-1]
    answer, left = '"text":"WAIT"', '"text":"LEFT"'
    better = EpisodeRecord.model_validate_json(second).model_copy(update={"score": 0.99}).to_json()
    forged = record_of(Episode("easy", seed=14).fly((2, 0, 0)), "scripted").to_json()
    # A bad flight cannot be taken out of the mean by calling it errored.
    errored = '"status":"errored","error":"500"'.join(results.rsplit('"status":"finished","error":null', 1))
    for files, told in (
        ({"calls": calls.replace(answer, left, 1)}, "has another request than this run sends"),
        ({"calls": start + last.replace(answer, left)}, "flight 1 does not follow from the model's answers"),
        ({"calls": start}, "call 1-60-1 has no answer, but the status of the flight is finished"),
        ({"calls": start, "flights": errored}, "call 1-60-1 has neither an answer nor a failure"),
        ({"calls": calls + last.replace('"turn":60', '"turn":61')}, "1 answers belong to no flight"),
        (
            {"flights": results.replace('"waits":0', '"waits":1', 1)},
            "flight 0 does not follow from the model's answers",
        ),
        ({"episodes": f"{first}{better}\n"}, "flight 1: the record does not fit its flight: score"),
        ({"episodes": f"{forged}\n{second}"}, "flight 0 does not follow from the model's answers"),
        ({"episodes": first, "flights": results.splitlines()[0]}, "flight 1 was begun but is not among the results"),
    ):
        for name, text in whole.items():
            (folder / name).write_text(files.get(name.partition(".")[0], text))
        with pytest.raises(InvalidValueError, match=told):
            verified_run(folder)
    for name, text in whole.items():
        (folder / name).write_text(text.replace('"scripted"', '"better"'))
    with pytest.raises(InvalidValueError, match="call 0-1-1 has another request"):
        verified_run(folder)


@pytest.mark.parametrize(
    ("usage", "tokens", "cost", "rows"),
    [
        ([None] * 3, (None, None, None), None, ("-", "-", "3", "-")),
        ([(None, 2)] * 3, (None, 6, 6), None, ("-", "at least 6", "3", "-")),
        ([(100, 2), None, (100, 4)], (200, 6, 206), 0.00086, ("at least 200", "at least 6", "1", "at least 0.0009")),
        ([(100, 2)] * 3, (300, 6, 306), 0.00126, ("300", "6", "0", "0.0013")),
    ],
)
def test_tokens_that_no_answer_reports_are_unknown_not_0(
    usage: list[Any], tokens: tuple[object, ...], cost: float | None, rows: tuple[str, ...], tmp_path: Path
) -> None:
    class Metered(Scripted):
        async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
            prompt, completion = usage[int(call_id.split("-")[1]) - 1] or (None, None)
            text = reply("greedy", request["messages"][1]["content"])
            return Answer(text=text, prompt_tokens=prompt, completion_tokens=completion)

    fly(Metered("greedy"), tmp_path / "run")
    run = verified_run(tmp_path / "run")
    figures = report(run, Options(price_prompt=4, price_completion=10), moves=False)
    assert tuple(figures["tokens"].values()) == tokens
    assert figures["cost_usd"] == (cost and pytest.approx(cost))
    write_report(run, figures)
    names = ("tokens: prompt", "tokens: completion", "answers without a count of tokens", "cost in US dollars")
    table = "".join(f"| {name} | {row} |\n" for name, row in zip(names, rows, strict=True))
    assert table in (tmp_path / "run" / "report.md").read_text()


def test_a_run_without_a_score_has_a_report(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 10**9, {"status": 500}]])
    done = scripted.infer("--seeds", "14:16", "--tries", "1", "--report")
    assert json.loads((done.folder / "report.json").read_text())["score"] is None
    assert "**INVALID**: 2 of 2 flights errored, more than 5%" in (done.folder / "report.md").read_text()
