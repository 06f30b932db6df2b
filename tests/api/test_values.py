"""The exact solvers behind the page: a map is solved for those who wait, and for nobody who has gone."""

import asyncio
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from drone_env.core.tasks import get_task
from drone_env.errors import TooLargeError
from drone_env.planning import map_graph, solvers
from drone_env.planning.solver import Solver
from drone_env.server import exact_values as module
from drone_env.server.exact_values import UNSOLVED, ExactValues

EASY = get_task("easy")


@contextmanager
def busy() -> Generator[tuple[ExactValues, threading.Event], None, None]:
    """Solvers that begin nothing until the event is set."""
    values, free = ExactValues(), threading.Event()
    values._thread.submit(free.wait)
    try:
        yield values, free
    finally:
        free.set()
        values.close()


async def gone(waiting: "asyncio.Task[Solver]") -> None:
    await asyncio.sleep(0)
    waiting.cancel()
    await asyncio.gather(waiting, return_exceptions=True)


def test_a_map_that_nobody_waits_for_any_more_is_not_begun() -> None:
    async def fly(values: ExactValues, free: threading.Event) -> None:
        left, kept = (asyncio.create_task(values.solved(EASY, seed)) for seed in (1, 2))
        await gone(left)
        free.set()
        await kept
        # One thread solves them in turn: the first would have been done before the second.
        assert (values.get(EASY, 1) is None, values.get(EASY, 2) is None) == (True, False)
        await values.solved(EASY, 1)
        assert values.get(EASY, 1) is not None

    with busy() as (values, free):
        asyncio.run(fly(values, free))


def test_a_map_that_could_not_be_solved_is_tried_anew(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def ask(values: ExactValues, free: threading.Event) -> None:
        with monkeypatch.context() as today:
            today.setattr(solvers, "solver_of", out_of_memory)
            asked = asyncio.gather(*[values.solved(EASY, 1) for _ in range(2)], return_exceptions=True)
            await asyncio.sleep(0)
            free.set()
            assert [str(error) for error in await asked] == [UNSOLVED] * 2
        assert caplog.text.count("MemoryError: it is all gone") == 1
        await values.solved(EASY, 1)
        assert values.get(EASY, 1) is not None

    with busy() as (values, free):
        asyncio.run(ask(values, free))


def test_a_map_that_is_too_large_is_refused_to_all_who_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_graph, "MAX_BYTES", 0)
    with busy() as (values, free):
        free.set()
        for _ in range(2):
            with pytest.raises(TooLargeError, match="GB are allowed"):
                asyncio.run(values.solved(EASY, 1))
            with pytest.raises(TooLargeError, match="GB are allowed"):
                values.solver_of(EASY, 1)
        assert values.get(EASY, 1) is None


def test_who_waits_in_a_thread_gets_the_same_solver_and_keeps_it_wanted(eventually: Callable[..., None]) -> None:
    async def leave(values: ExactValues) -> None:
        await gone(asyncio.create_task(values.solved(EASY, 1)))

    with busy() as (values, free), ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(values.solver_of, EASY, 1)
        eventually(lambda: values._waiting[(EASY, 1)] == 1)
        asyncio.run(leave(values))
        free.set()
        assert waiting.result(60) is values.solver_of(EASY, 1) is values.get(EASY, 1)


def out_of_memory(_: object) -> None:
    raise MemoryError("it is all gone")


def test_who_goes_takes_no_map_from_those_who_still_wait() -> None:
    async def fly(values: ExactValues, free: threading.Event) -> None:
        left, kept = (asyncio.create_task(values.solved(EASY, 1)) for _ in range(2))
        await gone(left)
        free.set()
        await kept
        assert values.get(EASY, 1) is not None

    with busy() as (values, free):
        asyncio.run(fly(values, free))


def test_the_solvers_that_were_asked_for_last_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask(values: ExactValues) -> list[bool]:
        for seed in (1, 2):
            await values.solved(EASY, seed)
        assert values.get(EASY, 1) is not None
        await values.solved(EASY, 3)
        return [values.get(EASY, seed) is not None for seed in (1, 2, 3)]

    with busy() as (values, free):
        free.set()
        asyncio.run(values.solved(EASY, 0))
        one = values.get(EASY, 0)
        assert one is not None
        monkeypatch.setattr(module, "MAX_BYTES", 2.5 * one.nbytes)
        assert asyncio.run(ask(values)) == [True, False, True]
        monkeypatch.setattr(module, "MAX_BYTES", 0)
        asyncio.run(values.solved(EASY, 4))
        assert [values.get(EASY, seed) is not None for seed in (1, 3, 4)] == [False, False, True]
