"""Worker processes: limits, fairness, dropped jobs."""

import asyncio
import itertools
import os
import signal
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.requests import Request

from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import CheckpointError, TooLargeError
from drone_env.server import workers
from drone_env.server.exceptions import RequestError
from drone_env.server.settings import Settings
from drone_env.server.state import AppState
from drone_env.server.workers import Workers
from tests.tools import eventually
from tests.toy import TOY

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workers]:
    made = Workers(Settings(data=tmp_path_factory.mktemp("pool"), job_seconds=1, job_megabytes=64))
    yield made
    made.close()


@pytest.fixture
def gate(tmp_path: Path) -> Path:
    """A pipe: `wait_at` returns once the test writes to it."""
    os.mkfifo(tmp_path / "gate")
    return tmp_path / "gate"


def wait_at(gate: Path) -> int:
    gate.read_text()
    return os.getpid()


def note(file: Path, text: str) -> str:
    with file.open("a") as notes:
        notes.write(text)
    return text


def fail(error: Exception) -> None:
    raise error


def spin() -> None:
    """Stay in compiled code."""
    deque(itertools.repeat(0), maxlen=0)


def has_ended(process: int) -> bool:
    with suppress(ProcessLookupError):
        os.kill(process, 0)
        return False
    return True


def allocate(megabytes: int) -> int:
    return int(np.ones(megabytes << 20, np.uint8)[::4096].sum())


def test_a_result_and_an_error_come_back(pool: Workers) -> None:
    assert pool.submit(abs, -3, caller="a").result() == 3
    with pytest.raises(CheckpointError, match="broken"):
        pool.submit(fail, CheckpointError("broken"), caller="a").result()
    with pytest.raises(RequestError, match="the server failed") as failed:
        pool.submit(fail, KeyError("unforeseen"), caller="a").result()
    assert failed.value.status == 500
    with pytest.raises(RequestError, match="the server failed"):
        pool.submit(abs, lambda: 3, caller="a").result()  # it cannot be pickled
    assert pool.submit(abs, -3, caller="a").result() == 3


def test_too_much_time_and_memory_are_refused_and_the_next_job_runs(pool: Workers) -> None:
    with pytest.raises(TooLargeError, match="MB of memory"):
        pool.submit(allocate, 80, caller="a").result()
    assert pool.submit(allocate, 40, caller="a").result()
    with pytest.raises(TooLargeError, match="s of CPU time"):
        pool.submit(spin, caller="a").result()
    assert pool.submit(abs, -3, caller="a").result() == 3


def test_a_worker_that_is_killed_costs_at_most_its_own_job(pool: Workers) -> None:
    worker = pool.submit(os.getpid, caller="a").result()
    os.kill(worker, signal.SIGKILL)
    eventually(lambda: has_ended(worker))
    assert pool.submit(abs, -3, caller="a").result() == 3
    with pytest.raises(RequestError, match="the server failed"):
        pool.submit(signal.raise_signal, signal.SIGKILL, caller="a").result()
    with pytest.raises(RequestError, match="was stopped: try again later") as stopped:
        pool.submit(signal.raise_signal, signal.SIGTERM, caller="a").result()
    assert stopped.value.status == 503


def test_callers_take_turns_and_dropped_jobs_do_not_run(pool: Workers, gate: Path, tmp_path: Path) -> None:
    notes = tmp_path / "notes"
    first = pool.submit(wait_at, gate, caller="a")
    eventually(first.running)
    submitted = {text: pool.submit(note, notes, text, caller=text[0]) for text in ("a1", "a2", "a3", "b1", "c1", "b2")}
    assert submitted["c1"].cancel()
    gate.write_text("")
    first.result()
    submitted["a3"].result()
    assert notes.read_text() == "a1b1a2b2a3"
    assert submitted["c1"].cancelled()


def test_quick_jobs_do_not_wait_for_long_ones(pool: Workers, gate: Path) -> None:
    long = pool.submit(wait_at, gate, caller="a")
    assert pool.submit(abs, -3, caller="a", task="easy").result() == 3
    gate.write_text("")
    long.result()


def test_too_many_jobs_are_refused_by_caller_and_in_all(
    pool: Workers, gate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "WAITING", 3)
    running = pool.submit(wait_at, gate, caller="a")
    eventually(running.running)
    waiting = [pool.submit(abs, -3, caller="a") for _ in range(2)]
    with pytest.raises(RequestError, match="try again later") as refused:
        pool.submit(abs, -3, caller="a")
    assert (refused.value.status, refused.value.code) == (503, "busy")
    waiting.append(pool.submit(abs, -3, caller="b"))
    with pytest.raises(RequestError, match="try again later"):
        pool.submit(abs, -3, caller="c")
    gate.write_text("")
    assert [job.result() for job in waiting] == [3] * 3


def test_closing_drops_everything(gate: Path, tmp_path: Path) -> None:
    pool = Workers(Settings(data=tmp_path / "data"))
    running, waiting = (pool.submit(wait_at, gate, caller="a") for _ in range(2))
    with gate.open("w"):  # once the worker reads
        pool.close()
    assert waiting.cancelled()
    with pytest.raises(RequestError, match="was stopped"):
        running.result()
    with pytest.raises(RequestError, match="stopping"):
        pool.submit(abs, -3, caller="a")


def test_workers_know_the_tasks_that_the_server_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASKS, "toy", TOY)
    pool = Workers(Settings(data=tmp_path / "data"))
    assert pool.submit(get_task, "toy", caller="a").result() == TOY
    pool.close()


def test_a_job_is_dropped_when_its_caller_leaves(tmp_path: Path, gate: Path) -> None:
    shared, gone = AppState(Settings(data=tmp_path / "data")), asyncio.Event()

    async def receive() -> dict[str, Any]:
        await gone.wait()
        return {"type": "http.disconnect"}

    async def ask() -> None:
        request = Request({"type": "http", "client": ("10.0.0.1", 1)}, receive)
        asked = asyncio.create_task(shared.work(request, note, tmp_path / "notes", "flown"))
        while "10.0.0.1" not in shared.workers._waiting[False]:
            await asyncio.sleep(0)
        gone.set()
        with pytest.raises(RequestError, match="has left"):
            await asked

    shared.open()
    try:
        running = shared.workers.submit(wait_at, gate, caller="b")
        eventually(running.running)
        asyncio.run(ask())
        gate.write_text("")
        running.result()
        assert shared.workers.submit(abs, -3, caller="b").result() == 3
        assert not (tmp_path / "notes").exists()
    finally:
        shared.close()
