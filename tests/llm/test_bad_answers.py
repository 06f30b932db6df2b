"""Answers that are no action: asked for once more, then a WAIT; nobody else ever flies."""

import json
from collections.abc import Callable

import pytest

from drone_env.cli import main

from .conftest import Endpoint
from .log_lines import blocks, verified

Start = Callable[..., Endpoint]


def test_a_flight_of_bad_answers_waits_to_its_end_and_its_run_is_marked(
    endpoint: Start, capfd: pytest.CaptureFixture[str]
) -> None:
    scripted = endpoint(pilot="NORTH")
    done = scripted.infer("--seeds", "14:15", "--report", "--no-moves")
    assert done.status == 0, done.err
    assert done.turns == {"illegal": 60}
    assert len(scripted.requests()) == 120
    (flight,) = done.flights
    assert (flight["waits"], flight["score"], flight["success"]) == (60, 0.01, False)
    (lines,) = blocks(done.out)
    assert {(line.split()[2], line.split()[5]) for line in lines[1:-1]} == {("action=WAIT", "error=illegal")}
    assert "WAIT in place: 60" in done.err
    verified(done)
    # Beside the score, wherever it is shown.
    told, mark = "100.0% (60 of 60) !", "MARKED: 60 of 60 answers were unusable, more than 5%; the drone waited instead"
    assert f"mean score 0.0100 over 1 flights, 0 delivered everything; unusable answers: {told}\n" in done.err
    assert f"verdict: valid; {mark}\n" in done.err
    figures = json.loads((done.folder / "report.json").read_text())
    assert (figures["verdict"], figures["unusable"]["share"], figures["unusable"]["marked"]) == ("valid", 1, True)
    text = (done.folder / "report.md").read_text()
    assert f"**valid**; {mark}\n" in text
    assert f"| score (95 %) | 0.0100 |\n| unusable answers | {told} |\n" in text
    assert mark in (done.folder / "report.html").read_text()
    capfd.readouterr()
    assert main(["leaderboard", str(done.folder)]) == 0
    assert told in capfd.readouterr().out


def test_bad_answers_are_repaired_once_then_wait(endpoint: Start) -> None:
    pilot = "I would fly to the right. " * 4_000
    done = endpoint(pilot=pilot, finish_reason="length").infer("--seeds", "14:15", "--max-calls", "4")
    assert (done.status, done.turns) == (3, {"truncated": 2, "budget_stop": 1}), done.err
    assert [call["answer"]["text"] for call in done.calls] == [pilot] * 4
    # The model sees the beginning of its long answer.
    assert done.calls[1]["messages"][2]["content"] == pilot[:2000]
    assert [(call["turn"], call["attempt"]) for call in done.calls] == [(1, 1), (1, 2), (2, 1), (2, 2)]
    (lines,) = blocks(done.out)
    assert [line.split()[2::3] for line in lines[1:-1]] == [["action=WAIT", "error=truncated"]] * 2
    assert "a larger --max-answer-tokens" in done.err
    verified(done)


def test_an_answer_that_the_repair_mends(endpoint: Start) -> None:
    scripted = endpoint(pilot="Let us go up!", repair="greedy")
    done = scripted.infer("--seeds", "14:15")
    assert done.status == 0, done.err
    assert done.turns == {"repaired": 3}
    assert len(scripted.requests()) == 6
    assert done.flights[0]["score"] == 0.99
    assert done.flights[0]["waits"] == 0
    asked, again = (request["body"]["messages"] for request in scripted.requests()[:2])
    assert again[:2] == asked
    assert again[2] == {"role": "assistant", "content": "Let us go up!"}
    assert "could not be used: the answer is not one action" in again[3]["content"]
