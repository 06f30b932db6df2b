"""The store: finished flights, open sessions and optima in one SQLite file.

Several processes and threads may use one folder at once. Each finished call survives SIGKILL. Power
loss may undo the last transactions, but never leaves a broken file. The folder must be on a local disk. Open a store in
each process: it does not survive a fork.
"""

import json
import logging
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import DroneEnvError, EpisodeError, InvalidValueError, StoreError, UnknownNameError
from drone_env.files import write_text
from drone_env.flights.database import Database
from drone_env.flights.episodes import (
    SELECT_BEST,
    SELECT_BY_MAP,
    SELECT_ROWS,
    Analysis,
    EpisodeSummary,
    StoredEpisode,
    analyse,
    summary_of,
)
from drone_env.flights.flight import COLUMNS, Flight, check_task, digits_of, insert_flight, new_id
from drone_env.flights.optima import Map, Optima, Submit
from drone_env.flights.provenance import HUMAN, Provenance

log = logging.getLogger(__name__)
FILE_NAME = "drone_env.sqlite3"
VIEW_NAME = "memory.json"
VIEW_LENGTH = 100
VIEW_SECONDS = 0.05
"""Flights that end within this time are shown together."""
VIEW_HEAD, NEXT_LINE, VIEW_FOOT = '{"format": "drone_env/memory", "format_version": 1, "episodes": [\n', ",\n", "\n]}\n"
PATIENCE = 0.5
"""Seconds to wait for optima."""
NEWEST = "ORDER BY number DESC LIMIT ?"
SELECT_STORED = f"SELECT {COLUMNS}, finished_at, reward_total, score FROM flights WHERE id = ? AND number IS NOT NULL"


class Store:
    """The store in `folder`: `drone_env.sqlite3`, and `memory.json` as a view of the last 100 finished episodes.

    Threads may share it. A context manager.

    Args:
        folder: Created if it is missing.
        submit: Starts to solve the maps of a list in another process; None for a thread of the store.

    Raises:
        OSError: if the folder or the file cannot be created.
        StoreError: if the file is not a store of this version, cannot be opened, or contains flights of another task
            under the name of a registered one.
    """

    def __init__(self, folder: str | Path, submit: Submit | None = None) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.database = Database(self.folder / FILE_NAME)
        try:
            with self.database.reading() as connection:
                for task in list(TASKS.values()):
                    check_task(connection, task)
        except BaseException:
            self.database.close()
            raise
        self._optima = Optima(self.database, submit)
        self._lines: dict[str, str] = {}
        """JSON of the episodes in `memory.json` by id; empty for one that cannot be flown again."""
        self._shown: list[str] | None = None
        """Ids of these episodes; None if the file is not written."""
        self._view_due, self._closing = threading.Event(), threading.Event()
        self._view_thread = ThreadPoolExecutor(1, "drone_env-memory-view")
        self._view_thread.submit(self._read_view)
        self.show()

    def close(self) -> None:
        """Close the file; a second call does nothing. Waits for `memory.json`."""
        self._optima.close()
        self._closing.set()
        self._view_thread.shutdown()
        self.database.close()

    def check(self) -> None:
        """Check that steps can be stored: the last write succeeded, and the file was not deleted or replaced.

        Raises:
            StoreError: if nothing can be stored.
        """
        self.database.check()
        if self.database.failed:
            raise StoreError(f"store {self.database.path}: the last write failed")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def add_episode(self, episode: Episode, agent: str | Provenance, episode_id: str | None = None) -> str:
        """Store a finished episode and return its id; `memory.json` shows it a moment later.

        Args:
            episode: The flight.
            agent: Who flew.
            episode_id: Its id, 16 hex digits; None for a new one. If the id is stored already, nothing changes.

        Raises:
            EpisodeError: if the episode has not ended.
            InvalidValueError: if the agent's name is not one printable line.
            StoreError: if it could not be written; nothing is stored then.
        """
        if not episode.ended:
            raise EpisodeError("the episode has not ended: only finished ones are stored")
        provenance, flight_id = Provenance.of(agent), episode_id or new_id()
        with self.database.writing() as connection:
            is_new = insert_flight(connection, flight_id, episode, provenance)
        if is_new:
            self.show()
        return flight_id

    def episode(self, episode_id: str) -> StoredEpisode:
        """Return the episode of an id, flown again.

        Raises:
            UnknownNameError: if there is none; the message names no other episode, since ids are not public. Also if
                its task or reward profile is no longer registered.
            InvalidValueError: if its reward profile has changed.
            StoreError: if the store cannot be read.
        """
        for row in self._read(SELECT_STORED, (episode_id,)):
            return _stored(row)
        raise UnknownNameError("episode", episode_id, ())

    def listed(
        self,
        n: int,
        task: str | TaskConfig | None = None,
        agent: str | None = None,
        before: int | None = None,
        seed: int | None = None,
    ) -> list[EpisodeSummary]:
        """Return the last `n` finished episodes with the optima of their maps, newest first.

        Unknown optima are solved as in `analysis`, except those of tasks that are not registered. All filters that are
        not None must hold.

        Args:
            n: How many.
            task: The task.
            agent: The pilot.
            before: The episode was stored before the one of this number.
            seed: The map.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        where, values = _where(task, {"agent =": agent, "number <": before, "seed =": seed})
        rows = self._read_solved(f"{SELECT_ROWS} {where} {NEWEST}", (*values, n), "seed")
        return [summary_of(row) for row in rows]

    def means_by_map(self, task: str | TaskConfig) -> list[sqlite3.Row]:
        """Return the means of each agent's flights over each map of a task; optima as in `listed`.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        where, values = _where(task)
        return self._read_solved(SELECT_BY_MAP.format(where=where), values, "seeds")

    def best(self, task: str | TaskConfig, seed: int, since: float, n: int) -> list[EpisodeSummary]:
        """Return the best flights by hand over a map, without help and forks: one for each name, the best first.

        Flights of equal score and length are in the order of storing.

        Args:
            task: The task.
            seed: The map.
            since: The earliest time of storing, in seconds since 1970.
            n: How many, 0 or more.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        filters = {"seed =": seed, "finished_at >=": since, "pilot =": HUMAN, "values_used =": 0, "undo_used =": 0}
        where, values = _where(task, filters)
        return [summary_of(row) for row in self._read(SELECT_BEST.format(where=where), (*values, n))]

    def flown_before(self, episode: Episode) -> list[tuple[str, Provenance]]:
        """Return the id and the provenance of the flights with the map, actions and reward profile of an episode.

        Raises:
            StoreError: if the store cannot be read.
        """
        flown = {"seed =": episode.seed, "reward_profile =": episode.reward_profile.id}
        where, values = _where(episode.task, {**flown, "actions =": digits_of(episode.actions)})
        rows = self._read(f"SELECT {COLUMNS} FROM flights {where} ORDER BY number", values)
        return [(row["id"], Flight(*row).provenance) for row in rows]

    def stored_ids(self, episode_ids: Iterable[str]) -> set[str]:
        """Return the ids that the store contains."""
        return {
            id_
            for id_ in episode_ids
            if self._read("SELECT 1 FROM flights WHERE id = ? AND number IS NOT NULL", (id_,))
        }

    def episodes(self) -> Iterator[StoredEpisode]:
        """Yield all finished episodes, oldest first. Those that cannot be flown again are logged and left out.

        Raises:
            StoreError: if the store cannot be read.
        """
        # One by one, since an open reader prevents SQLite from truncating its log.
        for row in self._read("SELECT id FROM flights WHERE number IS NOT NULL ORDER BY number"):
            try:
                yield self.episode(row["id"])
            except (InvalidValueError, UnknownNameError) as error:
                log.warning("flight %s is left out: %s", row["id"], error)

    def analysis(self, task: str | TaskConfig, last: int = 1000) -> Analysis:
        """Return statistics of the last episodes of a task.

        Each map is solved once, in the background; this call waits up to `PATIENCE` seconds. `mean_regret` omits the
        maps that are not solved by then.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        rows = self.listed(last, task)
        where, values = _where(task)
        ((total,),) = self._read(f"SELECT count(*) FROM flights {where}", values)
        return analyse(get_task(task), total, rows)

    def show(self) -> None:
        """Show the flights that have just been stored in `memory.json`, soon."""
        if not (self._view_due.is_set() or self._closing.is_set()):
            self._view_due.set()
            self._view_thread.submit(self._write_view)

    def _read_view(self) -> None:
        """Take over the lines of `memory.json`, which are then not flown again."""
        with suppress(OSError, ValueError, LookupError, TypeError):  # it is missing or damaged
            text = (self.folder / VIEW_NAME).read_text(encoding="utf-8")
            lines = text.removeprefix(VIEW_HEAD).removesuffix(VIEW_FOOT).split(NEXT_LINE)
            self._lines = {json.loads(line)["id"]: line for line in lines}

    def _write_view(self) -> None:
        """Replace `memory.json`: in its own thread, since that may wait for the disk."""
        self._closing.wait(VIEW_SECONDS)
        self._view_due.clear()
        query = f"SELECT id FROM flights WHERE number IS NOT NULL {NEWEST}"
        try:
            # Each process reads again after it writes, so no older view stays over a newer one.
            while (newest := [row["id"] for row in self._read(query, (VIEW_LENGTH,))[::-1]]) != self._shown:
                self._lines = {id_: self._lines.get(id_) or self._json(id_) for id_ in newest}
                lines = NEXT_LINE.join(filter(None, self._lines.values()))
                write_text(self.folder / VIEW_NAME, f"{VIEW_HEAD}{lines}{VIEW_FOOT}")
                self._shown = newest
        except (OSError, DroneEnvError) as error:
            # The episodes are safe in the store, and the next one tries again.
            self._shown = None
            log.warning("%s could not be written: %s", self.folder / VIEW_NAME, error)

    def _json(self, episode_id: str) -> str:
        try:
            return self.episode(episode_id).model_dump_json(exclude_none=True)
        except (InvalidValueError, UnknownNameError) as error:
            log.warning("%s leaves out flight %s: %s", VIEW_NAME, episode_id, error)
            return ""

    def _read_solved(self, query: str, values: tuple[object, ...], seed: str) -> list[sqlite3.Row]:
        """Run a query with a column `solved`; if maps are not solved, wait for the solver and run it again.

        Args:
            query: The query.
            values: Its values.
            seed: Its column with the number of the map.
        """
        rows = self._read(query, values)
        maps: dict[Map, None] = {}
        for row in rows:
            if not row["solved"]:
                with suppress(UnknownNameError):  # the plugin of the task is gone
                    maps[get_task(row["task"], row["task_version"]), row[seed]] = None
        if not maps:
            return rows
        self._optima.solve(maps, PATIENCE)
        return self._read(query, values)

    def _read(self, query: str, values: tuple[object, ...] = ()) -> list[sqlite3.Row]:
        with self.database.reading() as connection:
            return connection.execute(query, values).fetchall()


def _stored(row: sqlite3.Row) -> StoredEpisode:
    """Fly a stored flight again."""
    *flown, finished_at, reward_total, score = row
    flight = Flight(*flown)
    episode = flight.fly()
    if (episode.reward_total, episode.score) != (reward_total, score):
        profile = f"reward profile {flight.reward_profile!r}"
        raise InvalidValueError(f"{profile} has changed since this flight: register the new one under another name")
    return StoredEpisode.of(flight.id, finished_at, episode, flight.provenance)


def _where(task: str | TaskConfig | None, filters: Mapping[str, Any] | None = None) -> tuple[str, tuple[Any, ...]]:
    """Return a WHERE clause and its values: finished flights of a task that pass all filters that are not None.

    Raises:
        UnknownNameError: if there is no such task.
    """
    known = None if task is None else get_task(task)
    of_task = {} if known is None else {"task =": known.id, "task_version =": known.version}
    given = {name: value for name, value in {**of_task, **(filters or {})}.items() if value is not None}
    conditions = ["number IS NOT NULL", *(f"{name} ?" for name in given)]
    return f"WHERE {' AND '.join(conditions)}", tuple(given.values())
