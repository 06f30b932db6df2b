"""Runs that are killed in their middle: nothing is paid twice, no flight is lost or doubled."""

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drone_env.cli import main
from drone_env.errors import InvalidValueError
from drone_env.llm.transcript import Transcript, read_calls

from .conftest import ROOT, TOKEN, Endpoint, environment

KILLS = int(os.environ.get("DRONE_ENV_KILLS", "2"))


@pytest.mark.timeout(300 + 60 * KILLS)
def test_killed_again_and_again(endpoint: Callable[..., Endpoint], tmp_path: Path) -> None:
    scripted = endpoint(pilot="greedy", latency=0.1)
    folder = tmp_path / "run"
    transcript = folder / "calls.jsonl"
    flights = 10 * KILLS
    arguments = scripted.arguments("--seeds", f"0:{flights}", "--concurrency", "4", folder=folder)
    acknowledged: dict[str, int] = {}
    randomness = random.Random(1)
    for _ in range(KILLS):
        resume = ["--resume"] if (folder / "run.json").exists() else []
        before = len(scripted.requests())
        command = [sys.executable, str(ROOT / "inference.py"), *arguments[1:], *resume]
        process = subprocess.Popen(
            command, env=environment(OPENAI_API_KEY=TOKEN), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        # Somewhere in the middle of its calls.
        more = randomness.randint(1, 60)
        while len(scripted.requests()) < before + more:
            assert process.poll() is None, process.communicate()[1].decode()
            time.sleep(0.01)
        time.sleep(randomness.random() * 0.1)
        process.kill()
        process.communicate()
        # What was in the transcript when the process died is never asked for again.
        asked = [request["call"] for request in scripted.requests()]
        for call, count in acknowledged.items():
            assert asked.count(call) == count, call
        for _, call in read_calls(transcript):
            acknowledged.setdefault(str(call.key), asked.count(str(call.key)))
    done = scripted.infer("--seeds", f"0:{flights}", "--concurrency", "4", "--resume", folder=folder)
    assert done.status == 0, done.err
    asked = [request["call"] for request in scripted.requests()]
    assert [call for call, count in acknowledged.items() if asked.count(call) != count] == []
    assert len(acknowledged) > KILLS
    assert [flight["flight"] for flight in done.flights] == list(range(flights))
    assert done.out.count("[START]") == done.out.count("[END] success=true") == flights
    assert main(["replay", str(folder / "episodes.jsonl"), "--verify"]) == 0
    keys = [str(call.key) for _, call in read_calls(transcript)]
    assert len(keys) == len(set(keys)) == done.turns["ok"]
    undisturbed = scripted.infer("--seeds", f"0:{flights}")
    assert undisturbed.status == 0, undisturbed.err
    assert undisturbed.flights == done.flights


def test_a_cut_last_line_is_no_call_and_a_damaged_one_an_error(
    endpoint: Callable[..., Endpoint], tmp_path: Path
) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:15")
    path = done.folder / "calls.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-10])
    resumed = scripted.infer("--seeds", "14:15", "--resume", folder=done.folder)
    assert (resumed.status, resumed.out) == (0, done.out)
    assert [r["call"] for r in scripted.requests()] == ["0-1-1", "0-2-1", "0-3-1", "0-3-1"]
    path.write_bytes(b"{}\n" + whole)
    with pytest.raises(InvalidValueError, match=r"line 1 of .* is no call"):
        Transcript(path)
    path.write_bytes(whole + whole.splitlines(keepends=True)[0])
    with pytest.raises(InvalidValueError, match="call 0-1-1 has an answer already"):
        Transcript(path)


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
def test_a_call_that_finds_no_room_leaves_no_half_line(endpoint: Callable[..., Endpoint]) -> None:
    import resource

    scripted = endpoint(pilot="greedy")
    path = scripted.infer("--seeds", "14:15").folder / "calls.jsonl"
    whole = path.read_bytes()
    first, *_ = whole.splitlines(keepends=True)
    path.write_bytes(first)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    transcript = Transcript(path)
    call = transcript.calls[0].model_copy(update={"turn": 2})
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(first) + 10, limits[1]))
    try:
        with pytest.raises(OSError, match="could not be written whole"):
            transcript.append(call)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == first
    transcript.append(call)
    transcript.close()
    assert len(list(read_calls(path))) == 2


def test_the_transcript_of_another_request_is_refused(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:15")
    path = done.folder / "calls.jsonl"
    first, *rest = path.read_text().splitlines()
    changed = json.loads(first) | {"request_digest": "0" * 16}
    path.write_text("\n".join([json.dumps(changed), *rest, ""]))
    again = scripted.infer("--seeds", "14:15", "--resume", folder=done.folder)
    assert again.status == 2
    assert "asks something else" in again.err
