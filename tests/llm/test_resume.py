"""Runs that end in their middle: nothing is paid twice, no flight is lost or doubled."""

import signal
import subprocess
import sys

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.transcript import Transcript
from tests.tools import eventually

from .conftest import ROOT, TOKEN, Start, environment, json_lines, verified


def test_resume_refuses_another_configuration_and_a_new_run_an_old_folder(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:15")
    before = (first.folder / "calls.jsonl").read_bytes()
    again = scripted.infer("--seeds", "14:15", folder=first.folder)
    assert (again.status, "--resume" in again.err) == (2, True)
    none = scripted.infer("--seeds", "14:15", "--resume", folder=scripted.folder / "none")
    assert (none.status, "there is no run in " in none.err) == (2, True)
    other = scripted.infer("--seeds", "14:15", "--temperature", "1", "--resume", folder=first.folder)
    assert other.status == 2
    assert "another configuration: sampling" in other.err
    assert (first.folder / "calls.jsonl").read_bytes() == before
    same = scripted.infer("--seeds", "14:15", "--resume", folder=first.folder)
    assert (same.status, same.out) == (0, first.out)
    assert len(scripted.requests()) == 3


def test_two_runs_in_one_folder_and_ctrl_c(endpoint: Start) -> None:
    # The tenth request is not answered as long as the run lasts.
    scripted = endpoint(pilot="greedy", faults=[[9, 9, "hang"]])
    folder = scripted.folder / "run"
    flights = ("--task", "hard", "--episodes", "1")
    arguments = scripted.arguments(*flights, folder=folder)
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "inference.py"), *arguments[1:], "--timeout", "3600"],
        env=environment(OPENAI_API_KEY=TOKEN),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # What a shell starts in the background ignores SIGINT, and so do its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        eventually(lambda: len(scripted.requests()) == 10 or process.poll() is not None)
        second = scripted.infer(*flights, "--resume", folder=folder)
        assert (second.status, second.out) == (2, "")
        assert "another process is working on the run" in second.err
        # Each paid answer is written at once, so a kill would lose none.
        paid = json_lines(folder / "calls.jsonl")
        assert [(call["turn"], call["attempt"]) for call in paid] == [(turn, 1) for turn in range(1, 10)]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, out) == (130, ""), err
    assert f"--out {folder} --resume" in err
    assert "Traceback" not in err
    done = scripted.infer(*flights, "--resume", folder=folder)
    assert done.status == 0, done.err
    assert done.calls[:9] == paid
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
    for damaged, why in (
        (b"{}\n" + whole, r"line 1 of .* is no call"),
        (whole + whole.splitlines(keepends=True)[0], "call 0-1-1 has an answer already"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(InvalidValueError, match=why):
            Transcript(path)
