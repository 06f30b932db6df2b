"""The stored record of a flight. A replay gives everything else about the flight."""

import secrets
import sqlite3
import time
from collections.abc import Iterable
from dataclasses import astuple, dataclass

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import PACKAGE_TASKS, TaskConfig, get_task
from drone_env.errors import StoreError
from drone_env.flights.provenance import Parent, Provenance


@dataclass(frozen=True)
class Flight:
    """One flight: the columns of its row that are not computed from others. `parent` is the JSON of a `Parent`."""

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
    parent: str | None

    @property
    def provenance(self) -> Provenance:
        """Who flew it."""
        fields = {name: getattr(self, name) for name in Provenance.model_fields}
        parent = None if self.parent is None else Parent.model_validate_json(self.parent)
        return Provenance.model_validate({**fields, "parent": parent}, strict=False)

    def fly(self) -> Episode:
        """Fly it again.

        Raises:
            UnknownNameError: if its task or profile is no longer registered.
        """
        task = get_task(self.task, self.task_version)
        return Episode(task, self.reward_profile, self.seed).fly(map(Action, map(int, self.actions)))


COLUMNS = ", ".join(Flight.__dataclass_fields__)


def new_id() -> str:
    """Return a new id for a flight: 16 hex digits."""
    return secrets.token_hex(8)


def digits_of(actions: Iterable[int]) -> str:
    """Return actions as the store keeps them: one digit each."""
    return "".join(map(str, actions))


def insert_flight(connection: sqlite3.Connection, flight_id: str, episode: Episode, by: Provenance) -> bool:
    """Add the row of a flight, unless the id is stored already; returns whether it is new.

    Raises:
        StoreError: if the store has flights of another task of the same name.
    """
    task, parent = episode.task, None if by.parent is None else by.parent.model_dump_json()
    if task.id not in PACKAGE_TASKS:
        row = (task.id, task.version, task.digest)
        connection.execute("INSERT INTO own_tasks VALUES (?, ?, ?) ON CONFLICT DO NOTHING", row)
        check_task(connection, task)
    flown = (task.id, task.version, episode.seed, episode.reward_profile.id, digits_of(episode.actions))
    flight = Flight(flight_id, *flown, by.pilot, by.person, by.values_used, by.undo_used, parent)
    values = (*astuple(flight), by.label)
    places = ", ".join("?" * len(values))
    insert = f"INSERT INTO flights ({COLUMNS}, agent) VALUES ({places}) ON CONFLICT (id) DO NOTHING"
    is_new = connection.execute(insert, values).rowcount == 1
    if is_new and episode.ended:
        finish_flight(connection, flight_id, episode)
    return is_new


def check_task(connection: sqlite3.Connection, task: TaskConfig) -> None:
    """Check that the rows under the name of a task belong to this task.

    Raises:
        StoreError: if they belong to another task of the same name.
    """
    query = "SELECT rules FROM own_tasks WHERE task = ? AND task_version = ? AND rules != ?"
    for (rules,) in connection.execute(query, (task.id, task.version, task.digest)):
        raise StoreError(
            f"the store has flights of another task {task.id!r} (rules {rules}, now {task.digest}): "
            "rename the changed task, or use another data folder"
        )


def finish_flight(connection: sqlite3.Connection, flight_id: str, episode: Episode) -> None:
    """Write the numbers of a flight that has ended, which lists and indexes need."""
    delivered = (episode.deliveries_done, episode.task.deliveries)
    result = (episode.steps, episode.reward_total, episode.score, episode.outcome.name.lower())
    connection.execute(FINISH, (time.time(), *delivered, *result, flight_id))


FINISH = """
    UPDATE flights SET finished_at = ?, deliveries = ?, deliveries_total = ?, steps = ?, reward_total = ?, score = ?,
        outcome = ?, number = (SELECT ifnull(max(number), 0) + 1 FROM flights WHERE number IS NOT NULL)
    WHERE id = ? AND number IS NULL
"""
