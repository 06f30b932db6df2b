"""The stored record of a flight. A replay gives everything else about the flight."""

import re
import secrets
import sqlite3
import time
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256
from typing import NamedTuple

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.flights.provenance import Parent, Provenance

FLIGHT_ID = re.compile(r"[0-9a-f]{16}")
"""Form of the id of a flight."""


class MapKey(NamedTuple):
    """What a flight begins with: the map and the profile that pays."""

    task: str
    task_version: int
    seed: int
    reward_profile: str

    @classmethod
    def of(cls, episode: Episode) -> "MapKey":
        """Return the key of an episode."""
        return cls(episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id)


@dataclass(frozen=True)
class Flight:
    """One flight: the columns of its row that are not computed from others."""

    id: str
    task: str
    task_version: int
    seed: int
    reward_profile: str
    actions: str
    pilot: str
    person: str | None
    values_used: bool
    undo_used: bool
    parent_id: str | None
    parent_step: int | None

    def fly(self) -> Episode:
        """Fly it again.

        Raises:
            UnknownNameError: if its task or profile is no longer registered.
        """
        task = get_task(self.task, self.task_version)
        return Episode(task, self.reward_profile, self.seed).fly(map(int, self.actions))


COLUMNS = tuple(Flight.__dataclass_fields__)
SELECT_FLIGHT = f"SELECT {', '.join(COLUMNS)} FROM flights WHERE id = ?"


def new_id() -> str:
    """Return a new id for a flight: 16 hex digits."""
    return secrets.token_hex(8)


def digits_of(actions: Iterable[int]) -> str:
    """Return actions as the store keeps them: one digit each."""
    return "".join(map(str, actions))


def read_flight(connection: sqlite3.Connection, flight_id: str) -> Flight:
    """Return the flight of an id that the store contains."""
    return Flight(*connection.execute(SELECT_FLIGHT, (flight_id,)).fetchone())


def read_provenance(connection: sqlite3.Connection, flight: Flight) -> Provenance:
    """Return the provenance of a stored flight, with that of its parents."""
    parent = None
    if flight.parent_id is not None and flight.parent_step is not None:
        before = read_provenance(connection, read_flight(connection, flight.parent_id))
        parent = Parent(**dict(before), step=flight.parent_step)
    fields = {name: getattr(flight, name) for name in ("pilot", "person", "values_used", "undo_used")}
    return Provenance.model_validate({**fields, "parent": parent}, strict=False)


def insert_flight(
    connection: sqlite3.Connection, flight_id: str, key: MapKey, actions: str, provenance: Provenance
) -> None:
    """Add the row of an unfinished flight, after the row of its parent if that is missing.

    If the id is stored already, nothing changes.
    """
    parent = provenance.parent
    parent_id = None if parent is None else _parent_id(connection, key, actions[: parent.step], parent)
    values = (flight_id, *key, actions, provenance.pilot, provenance.person, provenance.values_used)
    values += (provenance.undo_used, parent_id, parent and parent.step, provenance.label)
    places = ", ".join("?" * len(values))
    connection.execute(
        f"INSERT INTO flights ({', '.join(COLUMNS)}, agent) VALUES ({places}) ON CONFLICT (id) DO NOTHING", values
    )


def _parent_id(connection: sqlite3.Connection, key: MapKey, actions: str, parent: Parent) -> str:
    """Return the stored flight that begins with these actions; if there is none, store them as an unfinished one."""
    found = connection.execute(
        "SELECT id FROM flights WHERE task = ? AND task_version = ? AND seed = ? AND reward_profile = ? AND agent = ? "
        "AND substr(actions, 1, ?) = ? AND (number IS NOT NULL OR id NOT IN (SELECT flight_id FROM sessions)) "
        "ORDER BY number IS NULL, number LIMIT 1",
        (*key, parent.label, len(actions), actions),
    ).fetchone()
    if found is not None:
        return found[0]
    flight_id = sha256(repr((key, actions, parent.label)).encode()).hexdigest()[:16]
    insert_flight(connection, flight_id, key, actions, parent)
    return flight_id


def finish_flight(connection: sqlite3.Connection, flight_id: str, episode: Episode) -> None:
    """Write the numbers of a flight that has ended, which lists and indexes need."""
    values = {
        "id": flight_id,
        "finished_at": time.time(),
        "deliveries": episode.deliveries_done,
        "deliveries_total": episode.task.deliveries,
        "steps": episode.steps,
        "reward_total": episode.reward_total,
        "score": episode.score,
        "outcome": episode.outcome.name.lower(),
    }
    connection.execute(FINISH, values)


FINISH = """
    UPDATE flights SET finished_at = :finished_at, deliveries = :deliveries, deliveries_total = :deliveries_total,
        steps = :steps, reward_total = :reward_total, score = :score, outcome = :outcome,
        number = (SELECT ifnull(max(number), 0) + 1 FROM flights WHERE number IS NOT NULL)
    WHERE id = :id AND number IS NULL
"""
