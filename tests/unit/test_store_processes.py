"""The store among threads, processes and kills."""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

from drone_env.results.record import replay
from drone_env.results.store import FILE_NAME, Store
from tests.unit.stores import eventually, opened, view

EXAMPLES = int(os.environ.get("DRONE_ENV_EXAMPLES", "200"))
KILLS = max(2, EXAMPLES // 100)
HAMMERED_STEPS = max(200, EXAMPLES // 5)
WORKER = Path(__file__).with_name("store_worker.py")


def worker(folder: Path, session_id: str, steps: int, seed: int, output: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, str(WORKER), str(folder), session_id, str(steps), str(seed)]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    # Into a file: a full pipe would decide when the worker stands still.
    with output.open("wb") as stdout:
        return subprocess.Popen(command, stdout=stdout, env=environment)


def said(output: Path) -> list[tuple[int, tuple[int, ...], str | None]]:
    """The whole lines that a worker printed after each step."""
    lines = [json.loads(line) for line in output.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    assert lines[:1] in ([], ["ready"])
    return [(seed, tuple(actions), finished) for seed, actions, finished in lines[1:]]


class ViewReader(threading.Thread):
    """Reads `memory.json` all the time, and keeps what went wrong."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.reads = 0
        self.error: BaseException | None = None
        self.done = threading.Event()

    def run(self) -> None:
        try:
            while not self.done.is_set():
                content = json.loads((self.folder / "memory.json").read_bytes())
                assert len(content["episodes"]) <= 100
                self.reads += 1
        except BaseException as error:
            self.error = error

    def __enter__(self) -> "ViewReader":
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.done.set()
        self.join()
        assert self.error is None
        assert self.reads > 0


def whole(store: Store, session_id: str) -> list[tuple[int, tuple[int, ...]]]:
    """(seed, actions) of all that a session has flown, checked to be what the worker's way of flying makes."""
    episodes = list(store.episodes())
    for stored in episodes:
        replay(stored.record)
    row = store.read_session(session_id)
    flown = [
        (e.record.seed, tuple(["UP", "DOWN", "LEFT", "RIGHT", "WAIT"].index(a) for a in e.record.actions))
        for e in episodes
    ]
    if row.episode_id is None:
        flown.append((row.seed, row.actions))
    else:
        assert row.episode_id == episodes[-1].id
    assert [seed for seed, _ in flown] == list(range(len(flown)))
    return flown


def test_processes_on_one_session_lose_no_step(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        session_id = opened(store, seed=0)
        with ViewReader(tmp_path):
            outputs = [tmp_path / "first", tmp_path / "second"]
            workers = [
                worker(tmp_path, session_id, HAMMERED_STEPS, seed, output) for seed, output in enumerate(outputs)
            ]
            try:
                assert [process.wait(timeout=200) for process in workers] == [0, 0]
            finally:
                for process in workers:
                    process.kill()
                    process.wait()
        steps = [step for output in outputs for step in said(output)]
        assert len(steps) == 2 * HAMMERED_STEPS
        # Each step was kept once: no two saw the session in the same state.
        assert len({(seed, len(actions)) for seed, actions, _ in steps}) == len(steps)
        flown = dict(whole(store, session_id))
        assert sum(map(len, flown.values())) == len(steps)
        assert all(flown[seed][: len(actions)] == actions for seed, actions, _ in steps)
        finished = {episode_id for _, _, episode_id in steps if episode_id}
        assert finished == {stored.id for stored in store.episodes()}
        assert len({seed for seed, _, _ in said(outputs[0])} & {seed for seed, _, _ in said(outputs[1])}) > 0
        expected = store.latest(100)[::-1]
        assert view(tmp_path) == expected


def test_killed_at_any_moment_nothing_that_was_said_is_lost(tmp_path: Path) -> None:
    rng = random.Random(0)
    with Store(tmp_path) as store:
        session_id = opened(store, seed=0)
    steps = 0
    with ViewReader(tmp_path):
        for kill in range(KILLS):
            output = tmp_path / "said"
            process = worker(tmp_path, session_id, 10**9, kill, output)
            try:
                # Somewhere in its first hundreds of steps.
                enough = rng.randrange(100, 20_000)
                eventually(lambda output=output, enough=enough: output.stat().st_size > enough)
            finally:
                process.send_signal(signal.SIGKILL)
                process.wait()
            assert process.returncode == -signal.SIGKILL
            told = said(output)
            steps += len(told)
            with Store(tmp_path) as store:
                flown = dict(whole(store, session_id))
                for seed, actions, episode_id in told:
                    assert flown[seed][: len(actions)] == actions
                    if episode_id is not None:
                        assert store.episode(episode_id).record.seed == seed
                # At most the one step is there that was kept, but not yet told of.
                ahead = sum(map(len, flown.values())) - steps
                assert 0 <= ahead <= kill + 1
                expected = store.latest(100)[::-1]
                assert view(tmp_path) == expected
            with sqlite3.connect(tmp_path / FILE_NAME) as connection:
                assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            connection.close()
    assert steps > KILLS
