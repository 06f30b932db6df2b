"""Runs that end in their middle: nothing is paid twice, no flight is lost or doubled."""

import contextlib
import signal
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.report import report
from drone_env.llm.run_folder import read_run
from drone_env.llm.transcript import Transcript
from tests.tools import PATIENCE, eventually

from .conftest import ROOT, TOKEN, Endpoint, Start, environment, json_lines, verified


@contextlib.contextmanager
def running(
    scripted: Endpoint, requests: int, folder: Path, *arguments: str
) -> Generator[subprocess.Popen[str], None, None]:
    """A process of `python inference.py` that has sent a number of requests; it is killed at the end of the `with`."""
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "inference.py"), *scripted.arguments(*arguments, folder=folder)[1:]],
        env=environment(OPENAI_API_KEY=TOKEN),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # What a shell starts in the background ignores SIGINT, and so do its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        eventually(lambda: len(scripted.requests()) == requests or process.poll() is not None)
        yield process
    finally:
        process.kill()
        process.communicate()


def test_resume_refuses_another_configuration_and_a_new_run_an_old_folder(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:15")
    before = (first.folder / "calls.jsonl").read_bytes()
    nowhere = scripted.folder / "none"
    for options, folder, told in (
        ((), first.folder, "--resume"),
        (("--resume",), nowhere, "there is no run in "),
        (("--temperature", "1", "--resume"), first.folder, "another configuration: sampling"),
    ):
        refused = scripted.infer("--seeds", "14:15", *options, folder=folder)
        assert (refused.status, told in refused.err) == (2, True)
    assert (first.folder / "calls.jsonl").read_bytes() == before
    same = scripted.infer("--seeds", "14:15", "--resume", folder=first.folder)
    assert (same.status, same.out, len(scripted.requests())) == (0, first.out, 3)


def test_two_runs_in_one_folder_and_ctrl_c(endpoint: Start) -> None:
    # The tenth request is not answered as long as the run lasts.
    scripted = endpoint(pilot="greedy", faults=[[9, 9, "hang"]])
    folder = scripted.folder / "run"
    flights = ("--task", "hard", "--episodes", "1")
    with running(scripted, 10, folder, *flights, "--timeout", "3600") as process:
        second = scripted.infer(*flights, "--resume", folder=folder)
        assert (second.status, second.out) == (2, "")
        assert "another process is working on the run" in second.err
        # Each paid answer is written at once, so a kill would lose none.
        paid = json_lines(folder / "calls.jsonl")
        assert [(call["turn"], call["attempt"]) for call in paid] == [(turn, 1) for turn in range(1, 10)]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    # One flight at a time prints each step as it happens.
    steps = [f"[STEP] step={number}" for number in range(1, 10)]
    assert (process.returncode, [line.partition(" action")[0] for line in out.splitlines()[1:]]) == (130, steps), err
    assert f"--out {folder} --resume" in err
    assert "Traceback" not in err
    done = scripted.infer(*flights, "--resume", folder=folder)
    assert (done.status, done.calls[:9]) == (0, paid), done.err
    asked = [request["call"] for request in scripted.requests()]
    assert [call for call in set(asked) if asked.count(call) > 1] == ["0-10-1"]
    verified(done)


def test_a_cut_last_line_is_no_call_and_a_damaged_one_an_error(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:15")
    path = done.folder / "calls.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    resumed = scripted.infer("--seeds", "14:15", "--resume", folder=done.folder)
    assert (resumed.status, resumed.out) == (0, done.out)
    assert [r["call"] for r in scripted.requests()] == ["0-1-1", "0-2-1", "0-3-1", "0-3-1"]
    assert [call["turn"] for call in resumed.calls] == [1, 2, 3]
    path.write_bytes(b"{}\n" + whole)
    with pytest.raises(InvalidValueError, match=r"line 1 of .* is no call"):
        Transcript(path)


def test_a_killed_run_goes_on_within_its_budget(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[2, 2, "hang"]])
    folder = scripted.folder / "run"
    arguments = ("--seeds", "14:16", "--max-calls", "4", "--concurrency", "1")
    with running(scripted, 3, folder, *arguments):
        pass
    assert len(json_lines(folder / "calls.jsonl")) == 2
    resumed = scripted.infer(*arguments, "--resume", folder=folder)
    assert (resumed.status, len(scripted.requests())) == (3, 5)
    assert [flight.status for flight in resumed.flights] == ["finished", "budget_stop"]
    verified(resumed)
    figures = report(read_run(folder)).report
    assert figures["calls"] == {"answered": 4, "requests": 4, "without_usage": 0}
