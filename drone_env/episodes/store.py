"""All that outlives the process: finished episodes and open sessions, in one SQLite file.

Several processes and threads may use one folder at once. What a method has returned survives the death of the process
at any moment, SIGKILL included; power loss may take the last transactions, and never leaves a broken file. The folder
must be on a local disk. A store must not be carried across a fork: open one in each process.
"""

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from pydantic import Field

from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.episodes.analysis import Analysis
from drone_env.episodes.record import EpisodeRecord
from drone_env.episodes.sessions import SessionRow
from drone_env.models import Count, Message, OutcomeName

FILE_NAME = "drone_env.sqlite3"
VIEW_NAME = "memory.json"
VIEW_LENGTH = 100


class StoredEpisode(Message):
    """One finished episode."""

    id: str = Field(description="Names the episode in its store.")
    finished_at: datetime = Field(description="When it was stored, UTC.")
    steps: Count = Field(description="Steps flown.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    reward_total: float = Field(description="Sum of all rewards.")
    outcome: OutcomeName = Field(description="How it ended.")
    record: EpisodeRecord = Field(description="The flight: task, seed, agent, actions, rewards, score.")


def data_folder() -> Path:
    """The folder of what is kept: `DRONE_ENV_DATA`, or `data` in the working directory."""
    return Path(os.environ.get("DRONE_ENV_DATA") or "data")


class Store:
    """The store in `folder`: `drone_env.sqlite3`, and `memory.json` as a view of the last 100 finished episodes.

    Safe to share between threads. `close` it, or use it in a `with`.

    Args:
        folder: Made where it is missing.

    Raises:
        OSError: if the folder cannot be made.
        StoreError: if the file in it is no store, was written by a newer version of this package, or cannot be opened.
    """

    def __init__(self, folder: str | Path) -> None:
        raise NotImplementedError

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        raise NotImplementedError

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Finished episodes

    def add_episode(self, episode: EpisodeRecord | Episode, agent: str | None = None) -> str:
        """Store a finished episode and return its id; `memory.json` shows it then.

        A record is flown again first, so that nothing is stored that is not so; an `Episode` is taken as it is.

        Args:
            episode: The flight.
            agent: Who flew an `Episode`; a record says so itself.

        Raises:
            EpisodeError: if the episode has not ended.
            InvalidValueError: if the record does not fit its flight, or `agent` is given with a record, or not given
                with an `Episode`, or not one printable line.
            UnknownNameError: if there is no such task, version or reward profile.
            StoreError: if it could not be written; then nothing is stored.
        """
        raise NotImplementedError

    def episode(self, id: str) -> StoredEpisode:
        """The episode of this id.

        Raises:
            UnknownNameError: if there is none.
        """
        raise NotImplementedError

    def latest(self, n: int, task: str | TaskConfig | None = None) -> list[StoredEpisode]:
        """The last `n` finished episodes, of one task or of all, newest first.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if n is negative.
        """
        raise NotImplementedError

    def episodes(self) -> Iterator[StoredEpisode]:
        """All finished episodes, oldest first, read as they are asked for."""
        raise NotImplementedError

    def analysis(self, task: str | TaskConfig, last: int = 1000, patience: float = 0.25) -> Analysis:
        """What the last episodes of a task come to.

        The optima that regret needs are solved once per map, in a thread of the store's, and kept; this call waits for
        them for at most `patience` seconds. The maps that are not solved by then are left out of `mean_regret`
        (`regret_episodes` says how many count) and are there in a later call.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if `last` is below 1.
        """
        raise NotImplementedError

    # Sessions

    def open_session(
        self, task: str, task_version: int, seed: int, reward_profile: str, agent: str, capacity: int
    ) -> str:
        """Open a session on a map and return its id, which cannot be guessed.

        Raises:
            CapacityError: if `capacity` sessions are open already; expire the idle ones first.
            UnknownNameError: if there is no such task, version or profile.
            InvalidValueError: if the seed is not in [0, 2^53), or the agent's name is not one printable line.
        """
        raise NotImplementedError

    @contextmanager
    def session(self, id: str) -> Generator[SessionRow, None, None]:
        """A session to be changed: nobody else writes to the store inside the block, so keep it short.

        At the end of the block its changes and the finished episode, if there is one, are kept together; if the block
        raises, nothing is kept, and an `Episode` that was stepped inside must be flown anew. Entering counts as use.

            with store.session(id) as row:
                reward = episode.step(action)
                row.append(action)
                if episode.ended:
                    row.finish(episode)

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            StoreError: if the store stays busy for 30 s, or cannot be written.
        """
        raise NotImplementedError
        yield

    def read_session(self, id: str) -> SessionRow:
        """A session as it stands, to be read only; does not wait for writers and does not count as use.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
        """
        raise NotImplementedError

    def end_session(self, id: str) -> None:
        """End a session: from now on it is gone.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired already.
        """
        raise NotImplementedError

    def expire_sessions(self, idle_seconds: float) -> list[str]:
        """End the sessions that were not used for so long, and return their ids.

        They are remembered as gone for a week.
        """
        raise NotImplementedError

    def count_sessions(self) -> int:
        """How many sessions are open."""
        raise NotImplementedError
