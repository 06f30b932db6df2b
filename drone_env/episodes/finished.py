"""Finished episodes as the store keeps them: whole, and as rows for lists and figures."""

import sqlite3
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any, NamedTuple, cast

from pydantic import Field, TypeAdapter, ValidationError
from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.episodes.record import AgentLabel, EpisodeRecord, parse_record, record_of
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.models import DIRECTIONS, Count, Message, OutcomeName

AGENT_LABEL: TypeAdapter[str] = TypeAdapter(AgentLabel)


class StoredEpisode(Message):
    """One finished episode."""

    id: str = Field(description="Names the episode in its store.")
    finished_at: datetime = Field(description="When it was stored, UTC.")
    steps: Count = Field(description="Steps flown.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    reward_total: float = Field(description="Sum of all rewards.")
    outcome: OutcomeName = Field(description="How it ended.")
    record: EpisodeRecord = Field(description="The flight: task, seed, agent, actions, rewards, score.")

    @classmethod
    def of(cls, episode_id: str, episode: Episode, agent: str) -> Self:
        """The stored form of an episode that has just ended.

        Raises:
            EpisodeError: if it has not ended.
            InvalidValueError: if the agent's name is not one printable line, or the task or the reward profile are not
                those that are known by their names.
            UnknownNameError: if they are not known at all.
        """
        if not episode.started or not episode.ended:
            raise EpisodeError("the episode has not ended: only finished ones are stored")
        task, profile = episode.task, episode.reward_profile
        if get_task(task.id, task.version) != task or get_reward_profile(profile.id) != profile:
            raise InvalidValueError(
                f"task {task.id!r} or reward profile {profile.id!r} are not the registered ones of that name, "
                "so nobody could fly the episode again"
            )
        return cls(
            id=episode_id,
            finished_at=datetime.now(timezone.utc),
            steps=episode.steps,
            deliveries_total=episode.task.deliveries,
            reward_total=episode.reward_total,
            outcome=cast(OutcomeName, episode.outcome.name.lower()),
            record=record_of(episode, check_agent(agent)),
        )


def check_agent(agent: str) -> str:
    """The name of an agent, as records take it.

    Raises:
        InvalidValueError: if it is not one printable line of 1 to 200 characters.
    """
    try:
        return AGENT_LABEL.validate_python(agent, strict=True)
    except ValidationError:
        raise InvalidValueError(
            f"an agent's name is one printable line of 1 to 200 characters, got {agent!r}"
        ) from None


class EpisodeRow(NamedTuple):
    """What is known of a finished episode without reading its record: a row of the table, and the optimum."""

    number: int
    """The order of storing; it rises forever."""
    id: str
    finished_at: float
    """When it was stored, in seconds since 1970."""
    task: str
    task_version: int
    seed: int
    reward_profile: str
    agent: str
    actions: str
    """One digit per action."""
    deliveries: int
    deliveries_total: int
    steps: int
    reward_total: float
    score: float
    outcome: OutcomeName
    solved: bool
    """Whether its map has been given to the solver."""
    optimum: float | None
    """The optimum of its map, None while it is not known, the task is not registered, or the map is too large."""


COLUMNS = EpisodeRow._fields[:-2]
SELECT_ROWS = (
    f"SELECT {', '.join([f'e.{name}' for name in COLUMNS])}, o.task IS NOT NULL, o.score "
    "FROM episodes e LEFT JOIN optima o USING (task, task_version, seed)"
)
SELECT_STORED = "SELECT number, id, finished_at, steps, deliveries_total, reward_total, outcome, record FROM episodes"


def selection(
    task: str | TaskConfig | None,
    agent: str | None = None,
    before: int | None = None,
    after: int | None = None,
    episode_id: str | None = None,
) -> tuple[str, tuple[object, ...]]:
    """The WHERE of the episodes that are meant, and its values.

    Raises:
        UnknownNameError: if there is no such task.
    """
    known = None if task is None else get_task(task)
    conditions = {
        "task = ?": None if known is None else known.id,
        "task_version = ?": None if known is None else known.version,
        "agent = ?": agent,
        "number < ?": before,
        "number > ?": after,
        "id = ?": episode_id,
    }
    given = {condition: value for condition, value in conditions.items() if value is not None}
    return f"WHERE {' AND '.join(given)}" if given else "", tuple(given.values())


def stored_episode(row: Sequence[Any], store: object) -> tuple[int, StoredEpisode]:
    """The number of an episode, and the episode.

    Args:
        row: One that `SELECT_STORED` gives.
        store: What an error calls the store.

    Raises:
        InvalidValueError: if its record cannot be read.
    """
    number, episode_id, finished_at, steps, deliveries_total, reward_total, outcome, record = row
    return number, StoredEpisode(
        id=episode_id,
        finished_at=utc(finished_at),
        steps=steps,
        deliveries_total=deliveries_total,
        reward_total=reward_total,
        outcome=outcome,
        record=parse_record(record, f"episode {episode_id} of {store}"),
    )


def insert_episode(connection: sqlite3.Connection, stored: StoredEpisode) -> None:
    """Add a finished episode, unless there is one of its id."""
    columns = (*COLUMNS[1:], "record")
    values = {
        **vars(stored.record),
        **vars(stored),
        "finished_at": stored.finished_at.timestamp(),
        "actions": "".join([str(DIRECTIONS.index(name)) for name in stored.record.actions]),
        "record": stored.record.to_json(),
    }
    places = ", ".join([f":{name}" for name in columns])
    connection.execute(
        f"INSERT INTO episodes ({', '.join(columns)}) VALUES ({places}) ON CONFLICT (id) DO NOTHING", values
    )


def utc(seconds: float) -> datetime:
    """A time that the store keeps, in seconds since 1970."""
    return datetime.fromtimestamp(seconds, timezone.utc)
