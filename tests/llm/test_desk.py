"""The desk that all flights of a run ask: places of flights that begin anew, answers that come twice."""

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.desk import Desk
from drone_env.llm.gate import Clock, Gate, LimitReachedError, StoppedError
from drone_env.llm.options import Options
from drone_env.llm.transcript import Call, CallKey, Transcript

from .virtual_time import Nobody, VirtualClock, run_config


def call(text: str) -> Call:
    answer = Answer(text=text, prompt_tokens=10, completion_tokens=1)
    return Call(
        flight=0,
        seed=0,
        repeat=0,
        turn=1,
        attempt=1,
        messages=[],
        request_digest="x",
        answer=answer,
        outcome="ok",
        latency=0.0,
        at=0.0,
    )


def at_desk(
    path: Path, work: Callable[[Desk, Gate], Any], options: Options | None = None, clock: Clock | None = None
) -> Transcript:
    async def run() -> Transcript:
        transcript, gate = Transcript(path), Gate(options or Options(concurrency=1), clock)
        await work(Desk(run_config(), transcript, gate, Nobody()), gate)
        transcript.close()
        return transcript

    return asyncio.run(run())


def test_a_flight_that_begins_anew_frees_its_place(tmp_path: Path) -> None:
    async def work(desk: Desk, gate: Gate) -> None:
        lost, waiting = CallKey(0, 1, 1), CallKey(1, 1, 1)
        await desk.acquire(0)
        # The other one waits for the only place, and its process dies as well.
        orphan = asyncio.ensure_future(desk.acquire(1))
        await asyncio.sleep(0)
        await desk.known(waiting, "x", "y")
        await desk.known(lost, "x", "y")
        with pytest.raises(StoppedError, match="begun again"):
            await orphan
        for flight in (0, 1):
            await asyncio.wait_for(desk.acquire(flight), 60)
            await desk.release(flight, 0)
        assert (gate.active, gate.requests) == (0, 3)

    at_desk(tmp_path / "calls.jsonl", work)


def test_of_two_answers_to_one_call_the_first_counts_and_both_are_paid(tmp_path: Path) -> None:
    async def work(desk: Desk, gate: Gate) -> None:
        assert await desk.record(call("UP"), "y") is None
        assert await desk.record(call("DOWN"), "y") == call("UP").answer
        assert gate.tokens == 22

    transcript = at_desk(tmp_path / "calls.jsonl", work)
    assert len(transcript.path.read_text().splitlines()) == 1


def test_an_overloaded_endpoint_is_sent_less_and_for_a_while_nothing(tmp_path: Path) -> None:
    clock = VirtualClock()

    async def work(desk: Desk, gate: Gate) -> None:
        await desk.acquire(0)
        await desk.release(0, None, overloaded=True, pause=7)
        assert gate.limit == 4
        await desk.acquire(1)
        assert clock.slept == [7]
        await desk.release(1, 0)
        assert gate.limit == 4.25
        # Where the run ends earlier, so does the pause.
        await desk.acquire(0)
        await desk.release(0, None, overloaded=True, pause=60)
        with pytest.raises(LimitReachedError, match="10 s have passed"):
            await desk.acquire(1)
        assert clock.slept == [7, 3]
        assert gate.active == 0

    at_desk(tmp_path / "calls.jsonl", work, Options(concurrency=100, max_seconds=10), clock)


@pytest.mark.parametrize("system", ["linux", "win32"])
def test_one_process_at_a_time_writes_a_transcript(
    system: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", system)
    first = Transcript(tmp_path / "calls.jsonl")
    with pytest.raises(InvalidValueError, match="another process writes"):
        Transcript(tmp_path / "calls.jsonl")
    first.close()
    Transcript(tmp_path / "calls.jsonl").close()
