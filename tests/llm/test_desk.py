"""The desk that all flights of a run ask: places of flights that begin anew, answers that come twice."""

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.clock import Clock
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.desk import LocalDesk, StoppedError
from drone_env.llm.limits import LimitReachedError, Limits, Spending
from drone_env.llm.pace import Pace
from drone_env.llm.transcript import Call, CallKey, Transcript

from .virtual_time import Nobody, VirtualClock


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
    path: Path,
    work: Callable[[LocalDesk, Spending, AdaptiveGate], Any],
    most: int = 1,
    clock: Clock | None = None,
) -> Transcript:
    clock = clock or Clock()

    async def run() -> Transcript:
        transcript, spending, gate = Transcript(path), Spending(Limits(), None, clock=clock), AdaptiveGate(most, clock)
        desk = LocalDesk("host", transcript, spending, gate, Pace(clock=clock), None, Nobody(), clock)
        await work(desk, spending, gate)
        transcript.close()
        return transcript

    return asyncio.run(run())


def test_a_flight_that_begins_anew_frees_its_place(tmp_path: Path) -> None:
    async def work(desk: LocalDesk, spending: Spending, gate: AdaptiveGate) -> None:
        lost, waiting = CallKey(0, 1, 1), CallKey(1, 1, 1)
        await desk.enter(lost)
        # The other one waits for the only place, and its process dies as well.
        orphan = asyncio.ensure_future(desk.enter(waiting))
        await asyncio.sleep(0)
        await desk.known(waiting, "x", "y")
        await desk.known(lost, "x", "y")
        with pytest.raises(StoppedError, match="begun anew"):
            await orphan
        for key in (lost, waiting):
            await asyncio.wait_for(desk.enter(key), 60)
            await desk.leave(key, answered=True)
        assert (gate.active, spending.requests) == (0, 3)

    at_desk(tmp_path / "calls.jsonl", work)


def test_of_two_answers_to_one_call_the_first_counts_and_both_are_paid(tmp_path: Path) -> None:
    async def work(desk: LocalDesk, spending: Spending, gate: AdaptiveGate) -> None:
        for text in ("UP", "DOWN"):
            recorded = await desk.record(call(text), "y")
            assert recorded.answer is not None
            assert recorded.answer.text == "UP"
        assert spending.tokens == 22

    transcript = at_desk(tmp_path / "calls.jsonl", work)
    assert len(transcript.path.read_text().splitlines()) == 1


def test_an_overloaded_endpoint_is_sent_less_and_for_a_while_nothing(tmp_path: Path) -> None:
    clock = VirtualClock()

    async def work(desk: LocalDesk, spending: Spending, gate: AdaptiveGate) -> None:
        first, second = CallKey(0, 1, 1), CallKey(1, 1, 1)
        await desk.enter(first)
        await desk.leave(first, answered=False, overloaded=True, pause=7)
        assert gate.limit == 4
        await desk.enter(second)
        assert clock.slept == [7]
        await desk.leave(second, answered=True)
        assert gate.limit == 4.25
        # Where the run ends earlier, so does the pause.
        spending.limits = Limits(seconds=10)
        await desk.enter(first)
        await desk.leave(first, answered=False, overloaded=True, pause=60)
        with pytest.raises(LimitReachedError, match="10 s have passed"):
            await desk.enter(second)
        assert clock.slept == [7, 3]
        assert gate.active == 0

    at_desk(tmp_path / "calls.jsonl", work, most=100, clock=clock)


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
