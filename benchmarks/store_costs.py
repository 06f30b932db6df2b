"""What sessions and steps cost the store: disk, CPU time, and the time for which nobody else can write."""

import multiprocessing
import sqlite3
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from drone_env.core.episode import Episode
from drone_env.results.store import FILE_NAME, Store

STEPS = 20
"""Flown in each session before anything is measured: a flight of the standard tasks lasts 7 to 160."""
ROWS = (10_000, 100_000)
TRANSACTIONS = 3_000
UNBOUNDED = 1_000_000


class StoreFigures(NamedTuple):
    """Cost of the store."""

    row_bytes: float
    """Of a session, with the page's share of the rest."""
    sweep_ms: dict[int, float]
    """Looking for idle sessions among this many, which every process does every 5 s while nobody else writes."""
    count_ms: dict[int, float]
    """Counting this many, which every new session does."""
    log_bytes: float
    """Written to SQLite's log for a step."""
    steps_per_second: dict[int, float]
    """Steps kept per second by this many processes together."""
    step_us: float
    """CPU time of keeping a step, in one process."""


def fill(folder: Path, task: str, counts: Sequence[int]) -> tuple[float, dict[int, float], dict[int, float]]:
    """Bytes of a session's row, milliseconds of a sweep and of a count, by how many rows there are."""
    sweep, counted = dict[int, float](), dict[int, float]()
    with Store(folder) as store, closing(sqlite3.connect(folder / FILE_NAME)) as copies:
        empty = folder_bytes(folder)
        with store.session(store.open_session(Episode(task, "tiered", 1), "bench", 1)) as row:
            row.actions = (0, 3, 1, 2) * (STEPS // 4)
        for count in counts:
            # Copies, under names as long as the store's: opening each would count all others each time.
            columns = "task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at"
            copies.execute(
                "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < ?) "
                f"INSERT INTO sessions (id, {columns}) "
                f"SELECT lower(hex(randomblob(16))), {columns} FROM n, (SELECT * FROM sessions LIMIT 1)",
                (count - store.count_sessions(),),
            )
            copies.commit()
            assert store.count_sessions() == count
            sweep[count] = middle(lambda: store.expire_sessions(86_400.0))
            counted[count] = middle(store.count_sessions)
        copies.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        return (folder_bytes(folder) - empty) / counts[-1], sweep, counted


def folder_bytes(folder: Path) -> int:
    """Size of the store's file."""
    return (folder / FILE_NAME).stat().st_size


def middle(call: Callable[[], object], times: int = 7) -> float:
    """Median time of a call, in milliseconds."""
    taken: list[float] = []
    for _ in range(times):
        started = time.perf_counter()
        call()
        taken.append((time.perf_counter() - started) * 1000)
    return statistics.median(taken)


def write_steps(folder: Path, task: str, number: int, results: "multiprocessing.Queue[tuple[float, float]]") -> None:
    """Store steps in own sessions, and append the time and CPU time of one step to `results`."""
    with Store(folder) as store:
        names = [store.open_session(Episode(task, "tiered", number), "bench", UNBOUNDED) for _ in range(64)]
        clock, cpu = time.perf_counter(), time.process_time()
        for step in range(TRANSACTIONS):
            with store.session(names[step % 64]) as row:
                row.actions = (*row.actions, step % 4)
        results.put(((time.perf_counter() - clock) / TRANSACTIONS, (time.process_time() - cpu) / TRANSACTIONS))


def write_rates(folder: Path, task: str) -> tuple[dict[int, float], float]:
    """Steps kept per second by 1 and by 3 processes together, and CPU seconds of one."""
    spawn = multiprocessing.get_context("spawn")
    rates, cpu = dict[int, float](), 0.0
    for count in (1, 3):
        results = spawn.Queue()
        writers = [spawn.Process(target=write_steps, args=(folder, task, n, results)) for n in range(count)]
        for writer in writers:
            writer.start()
        taken = [results.get() for _ in writers]
        for writer in writers:
            writer.join()
        rates[count] = sum(1 / seconds for seconds, _ in taken)
        cpu = taken[0][1] if count == 1 else cpu
    return rates, cpu


def log_bytes(folder: Path, task: str) -> float:
    """Bytes that a step adds to SQLite's log, from its length after the first steps since it was empty."""
    log = folder / f"{FILE_NAME}-wal"
    with Store(folder) as store:
        session = store.open_session(Episode(task, "tiered", 1), "bench", UNBOUNDED)
        before = log.stat().st_size
        for step in range(STEPS):
            with store.session(session) as row:
                row.actions = (*row.actions, step % 4)
        return (log.stat().st_size - before) / STEPS


def measure_store(task: str) -> StoreFigures:
    """Measure a store in a temporary folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        row_bytes, sweep, counted = fill(folder / "rows", task, ROWS)
        rates, cpu = write_rates(folder / "steps", task)
        return StoreFigures(row_bytes, sweep, counted, log_bytes(folder / "log", task), rates, cpu * 1e6)
