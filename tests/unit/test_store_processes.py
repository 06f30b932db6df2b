"""The store among processes and kills.

Run as a program, this file flies one session of a store at random:

    python test_store_processes.py FOLDER SESSION RANDOM_SEED

After each step it prints one line of JSON: [seed of the map, actions so far, id of the finished episode or null].
"""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

from drone_env.core.episode import Episode
from drone_env.flights.record import replay
from drone_env.flights.sessions import Session
from drone_env.flights.store import FILE_NAME, Store
from drone_env.models import DIRECTIONS
from tests.tools import eventually
from tests.unit.stores import actions, latest, opened, sessions_of, view

KILLS = max(2, int(os.environ.get("DRONE_ENV_EXAMPLES", "200")) // 100)


def fly(folder: str, session: str, random_seed: int) -> None:
    rng = random.Random(random_seed)

    def step(session: Session) -> list[object]:
        episode = session.episode
        if episode.ended:
            session.begin(Episode(episode.task, episode.reward_profile, episode.seed + 1))
        session.fly(rng.randrange(5))
        return [session.episode.seed, actions(session), session.episode_id]

    with Store(folder) as store:
        sessions = sessions_of(store)
        while True:
            flown = sessions.use(session, step)
            # One write, so that a killed process leaves whole lines but for the last.
            os.write(1, f"{json.dumps(flown)}\n".encode())


def worker(folder: Path, session_id: str, seed: int, output: Path) -> subprocess.Popen[bytes]:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    # Into a file: a full pipe would decide when the worker stands still.
    with output.open("wb") as stdout:
        return subprocess.Popen(
            [sys.executable, __file__, str(folder), session_id, str(seed)], stdout=stdout, env=environment
        )


def printed(output: Path) -> list[tuple[int, tuple[int, ...], str | None]]:
    """The whole lines that a worker printed after each step."""
    lines = [json.loads(line) for line in output.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    return [(seed, tuple(actions), finished) for seed, actions, finished in lines]


def flown_by(store: Store, session_id: str) -> dict[int, tuple[int, ...]]:
    """The actions that a session has flown on each map; its finished episodes are flown again."""
    episodes, session = list(store.episodes()), sessions_of(store).read(session_id)
    flown = [
        (stored.record.seed, tuple(map(DIRECTIONS.index, stored.record.actions)))
        for stored in episodes
        if replay(stored.record).ended
    ]
    if session.episode_id is None:
        flown.append((session.episode.seed, tuple(actions(session))))
    else:
        assert session.episode_id == episodes[-1].id
    assert [seed for seed, _ in flown] == list(range(len(flown)))
    return dict(flown)


def test_processes_on_one_session_lose_no_step_when_they_are_killed(tmp_path: Path) -> None:
    rng = random.Random(0)
    with Store(tmp_path) as store:
        session_id = opened(sessions_of(store), seed=0)
    steps: list[tuple[int, tuple[int, ...], str | None]] = []
    for kill in range(1, KILLS + 1):
        outputs = [tmp_path / "first", tmp_path / "second"]
        workers = [worker(tmp_path, session_id, 2 * kill + i, output) for i, output in enumerate(outputs)]
        try:
            # Somewhere in their first hundreds of steps.
            enough = rng.randrange(100, 6_000)
            eventually(lambda outputs=outputs, enough=enough: min(file.stat().st_size for file in outputs) > enough)
        finally:
            for process in workers:
                process.send_signal(signal.SIGKILL)
                process.wait()
        assert [process.returncode for process in workers] == [-signal.SIGKILL] * 2
        steps += [step for output in outputs for step in printed(output)]
        with Store(tmp_path) as store:
            flown = flown_by(store, session_id)
            # Each step was stored once: no two processes saw the session in the same state.
            assert len({(seed, len(actions)) for seed, actions, _ in steps}) == len(steps)
            assert all(flown[seed][: len(actions)] == actions for seed, actions, _ in steps)
            assert {id_ for _, _, id_ in steps if id_} <= {stored.id for stored in store.episodes()}
            # At most one step of each killed process is stored but not printed yet.
            assert 0 <= sum(map(len, flown.values())) - len(steps) <= 2 * kill
            eventually(lambda store=store: view(tmp_path) == latest(store, 100)[::-1])
        connection = sqlite3.connect(tmp_path / FILE_NAME)
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        connection.close()


if __name__ == "__main__":
    fly(sys.argv[1], sys.argv[2], int(sys.argv[3]))
