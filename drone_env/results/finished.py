"""Finished episodes in the store: whole, as rows of lists, put together by map, and their figures."""

import sqlite3
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from itertools import groupby
from operator import itemgetter
from typing import Annotated, Any, cast

from pydantic import Field, PlainSerializer, TypeAdapter, ValidationError, computed_field
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.models import DIRECTIONS, Count, Direction, Message, OutcomeName, Score, Seed
from drone_env.results.record import AgentLabel, EpisodeRecord, parse_record, record_of
from drone_env.results.result import EpisodesKey, Results
from drone_env.results.statistics import Summary, mean_of

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


def utc(seconds: float) -> datetime:
    """A stored time, in seconds since 1970."""
    return datetime.fromtimestamp(seconds, timezone.utc)


class EpisodeSummary(Message):
    """One finished episode, as its columns in the store tell it, with the optimum of its map."""

    number: int = Field(exclude=True, description="The order of storing; it rises forever.")
    id: str
    finished_at: Annotated[float, PlainSerializer(lambda seconds: utc(seconds).isoformat(), return_type=str)] = Field(
        description="UTC, ISO 8601."
    )
    task: str
    task_version: int
    seed: Seed
    reward_profile: str
    agent: str
    actions: str = Field(exclude=True, description="One digit per action.")
    deliveries: Count
    deliveries_total: Count
    steps: Count
    reward_total: float
    score: Score
    outcome: str
    solved: bool = Field(exclude=True, strict=False, description="Whether its map has been given to the solver.")
    optimal_score: Score | None = Field(description="The optimum of its map; null where it is not known.")

    @computed_field
    @property
    def success(self) -> bool:
        """Whether all parcels were delivered."""
        return self.outcome == "delivered"

    @computed_field
    @property
    def regret(self) -> Annotated[float, Field(ge=0)] | None:
        """optimal_score - score."""
        return None if self.optimal_score is None else self.optimal_score - self.score

    @classmethod
    def of(cls, row: Sequence[Any]) -> Self:
        """The summary of a row that `SELECT_ROWS` gives."""
        return cls(**dict(zip(SELECTED, row, strict=True)))


SELECTED = list(EpisodeSummary.model_fields)
COLUMNS = SELECTED[:-2]
SELECT_ROWS = (
    f"SELECT {', '.join([f'e.{name}' for name in COLUMNS])}, o.task IS NOT NULL, o.score "
    "FROM episodes e LEFT JOIN optima o USING (task, task_version, seed)"
)
STORED = list(StoredEpisode.model_fields)
SELECT_STORED = f"SELECT number, {', '.join(STORED)} FROM episodes"


# Columns beside one max() are those of the row where it is: https://sqlite.org/lang_select.html#bareagg
SELECT_BY_MAP = """
    SELECT e.agent, task, task_version, o.task IS NOT NULL,
        iif(count(DISTINCT e.reward_profile) = 1, e.reward_profile, NULL), max(e.number), seed, avg(e.score),
        avg(e.steps), avg(e.outcome = 'delivered'), o.score, count(*), avg(e.reward_total), e.id
    FROM episodes e LEFT JOIN optima o USING (task, task_version, seed) {where}
    GROUP BY e.agent, seed ORDER BY e.agent, seed
"""
"""The means of each agent's flights over each map, with the id of the newest; with the WHERE of one task's episodes."""
OF_RESULTS = ("seeds", "scores", "steps", "success", "optimal_scores", "flights", "rewards", "ids")
"""What `SELECT_BY_MAP` gives last, as `Results` names it."""


def results_by_agent(rows: Iterable[Sequence[Any]]) -> dict[str, Results]:
    """The results of each agent, one row per map, from the rows of `SELECT_BY_MAP`."""
    found: dict[str, Results] = {}
    for agent, of_agent in groupby(rows, key=itemgetter(0)):
        _, tasks, versions, _, profiles, _, *columns = zip(*of_agent, strict=True)
        named = dict(zip(OF_RESULTS, columns, strict=True))
        seeds = (named["seeds"][0], named["seeds"][-1] + 1)
        found[agent] = Results.of_rows(
            EpisodesKey(tasks[0], versions[0], "custom", seeds, agent),
            reward_profile=profiles[0] if len(set(profiles)) == 1 else None,
            **named,
        )
    return found


def selection(
    task: str | TaskConfig | None,
    agent: str | None = None,
    before: int | None = None,
    after: int | None = None,
    episode_id: str | None = None,
    seed: int | None = None,
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
        "seed = ?": seed,
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
    number, *values = row
    kept = dict(zip(STORED, values, strict=True))
    kept["finished_at"] = utc(kept["finished_at"])
    kept["record"] = parse_record(kept["record"], f"episode {kept['id']} of {store}")
    return number, StoredEpisode(**kept)


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


class Analysis(Message):
    """Figures over the newest finished episodes of one task, of all agents and reward profiles.

    What is not known is null.
    """

    task: str = Field(description="Id of the task.")
    episodes_total: Count = Field(description="Finished episodes of this task in the store.")
    episodes: Count = Field(description="The newest of them, over which everything below is counted.")
    average_reward: float | None = Field(description="Mean of the episodes' total rewards.")
    # Not bounded by 0.01 and 0.99: a mean of many 0.99 may be rounded beyond it.
    average_score: float | None = Field(ge=0, le=1, description="Mean graded score.")
    success_rate: float | None = Field(ge=0, le=1, description="Share of episodes that delivered everything.")
    success_trend: float | None = Field(
        ge=-1, le=1, description="Success rate of the newer half minus that of the older half; null below two episodes."
    )
    average_steps: float | None = Field(description="Mean length in steps.")
    average_deliveries: float | None = Field(description="Mean parcels delivered.")
    deliveries: Count = Field(description="Parcels delivered in all.")
    action_distribution: dict[Direction, float] = Field(description="Share of each action; all 0 without any step.")
    mean_regret: float | None = Field(
        ge=0, description="Mean of optimum of the map - score, over the episodes whose optimum is known."
    )
    regret_episodes: Count = Field(description="Episodes whose optimum is known; the others are being solved.")


def analyse(task: TaskConfig, total: int, rows: Sequence[EpisodeSummary]) -> Analysis:
    """The figures of the newest episodes of a task; each flight counts, also of several over one map.

    Args:
        task: The task.
        total: Finished episodes of this task in the store.
        rows: The newest of them, newest first.
    """
    success = [row.success for row in rows]
    results = Results.of_rows(
        EpisodesKey(task.id, task.version, "custom", (0, 0), "all"),
        seeds=[row.seed for row in rows],
        scores=[row.score for row in rows],
        steps=[row.steps for row in rows],
        success=success,
        optimal_scores=[row.optimal_score for row in rows],
    )
    summary, half, flown = Summary.of(results, by_map=False), len(rows) // 2, "".join([row.actions for row in rows])
    deliveries = [row.deliveries for row in rows]
    return Analysis(
        task=task.id,
        episodes_total=total,
        episodes=summary.flights,
        average_reward=mean_of([row.reward_total for row in rows]),
        average_score=summary.score,
        success_rate=summary.success_rate,
        # An odd episode in the middle belongs to neither half.
        success_trend=(sum(success[:half]) - sum(success[-half:])) / half if half else None,
        average_steps=summary.steps,
        average_deliveries=mean_of(deliveries),
        deliveries=sum(deliveries),
        action_distribution={action.name: flown.count(str(int(action))) / max(len(flown), 1) for action in Action},
        mean_regret=summary.regret,
        regret_episodes=summary.regret_maps,
    )
