"""What the tests of the store share."""

import json
import sqlite3
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

from drone_env.core.episode import Episode
from drone_env.planning.optimal import solve
from drone_env.results.sessions import Session, advance
from drone_env.results.store import FILE_NAME, Store, StoredEpisode


def flown(task: str = "easy", seed: int = 7, actions: str | None = None, profile: str = "tiered") -> Episode:
    """An episode flown to its end: with these actions again and again, or optimally."""
    episode = Episode(task, profile, seed)
    chosen = "".join(str(int(a)) for a in solve(task, seed).actions) if actions is None else actions
    while not episode.ended:
        episode.step(int(chosen[episode.steps % len(chosen)]))
    return episode


def opened(
    store: Store, task: str = "easy_delivery", seed: int = 7, capacity: int = 256, owner: str = "", steps: int = 0
) -> str:
    session_id = store.open_session(Episode(task, "tiered", seed), "someone", capacity, owner=owner)
    if steps:
        with store.session(session_id) as row:
            for _ in range(steps):
                advance(row, 4)
    return session_id


def finish_in(row: Session, episode: Episode) -> None:
    if row.task != episode.task.id:
        row.begin(Episode(episode.task, "tiered", episode.seed))
    for action in episode.actions:
        advance(row, action)


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
