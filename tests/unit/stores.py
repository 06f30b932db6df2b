"""What the tests of the store share."""

import json
import sqlite3
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager
from pathlib import Path

from drone_env.core.episode import Episode
from drone_env.flights.sessions import Session, Sessions
from drone_env.flights.store import FILE_NAME, Store, StoredEpisode
from drone_env.planning.optimal import solve


def flown(task: str = "easy", seed: int = 7, actions: str | None = None, profile: str = "tiered") -> Episode:
    """An episode flown to its end: with these actions again and again, or optimally."""
    episode = Episode(task, profile, seed)
    chosen = "".join(str(int(a)) for a in solve(task, seed).actions) if actions is None else actions
    while not episode.ended:
        episode.step(int(chosen[episode.steps % len(chosen)]))
    return episode


def sessions_of(
    store: Store, capacity: int = 256, idle_seconds: float = 60, clock: Callable[[], float] = lambda: 0.0
) -> Sessions:
    """The sessions of a store, as a server process has them."""
    return Sessions(store, capacity, idle_seconds, clock)


def opened(sessions: Sessions, task: str = "easy", seed: int = 7, owner: str = "", steps: int = 0) -> str:
    """A session that has waited for some steps."""
    return sessions.open(Episode(task, "tiered", seed).fly([4] * steps), "someone", owner=owner)


def actions(session: Session) -> list[int]:
    return session.episode.actions


def open_sessions(folder: Path) -> int:
    """The number of open sessions of a folder."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as file:
        return file.execute("SELECT count(*) FROM sessions").fetchone()[0]


@contextmanager
def failing(folder: Path, what: str) -> Generator[None, None, None]:
    """Have the store of a folder refuse something, such as "UPDATE ON sessions", for the time of the block."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as file:
        file.execute(f"CREATE TRIGGER broken BEFORE {what} BEGIN SELECT RAISE(ABORT, 'the disk is gone'); END")
        yield
        file.execute("DROP TRIGGER broken")


def latest(store: Store, n: int = 9) -> list[StoredEpisode]:
    """The last episodes, newest first."""
    return list(store.episodes())[::-1][:n]


def view(folder: Path) -> list[StoredEpisode]:
    content = json.loads((folder / "memory.json").read_bytes())
    assert (content["format"], content["format_version"]) == ("drone_env/memory", 1)
    return [StoredEpisode.model_validate_json(json.dumps(episode)) for episode in content["episodes"]]


def rows(folder: Path) -> dict[str, tuple[str, str, int | None]]:
    """The flights of a folder: agent, actions and number, by id."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as file:
        return {row[0]: row[1:] for row in file.execute("SELECT id, agent, actions, number FROM flights")}
