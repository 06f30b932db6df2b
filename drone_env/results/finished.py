"""Finished episodes in the store: the whole episode, rows for lists, results by agent and map, statistics of a task."""

import sqlite3
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from itertools import groupby
from typing import Annotated, cast

from pydantic import Field, PlainSerializer, TypeAdapter, ValidationError, computed_field
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.models import DIRECTIONS, Count, Direction, OutcomeName, Score, Seed, StrictModel
from drone_env.results.record import AgentLabel, EpisodeRecord, record_of
from drone_env.results.result import EpisodesKey, Results
from drone_env.results.statistics import mean_of

AGENT_LABEL: TypeAdapter[str] = TypeAdapter(AgentLabel)


class StoredEpisode(StrictModel):
    """One finished episode."""

    id: str = Field(description="Id of the episode in its store.")
    finished_at: datetime = Field(description="When it was stored, UTC.")
    steps: Count = Field(description="Steps flown.")
    deliveries_total: int = Field(ge=1, description="Parcels to deliver.")
    reward_total: float = Field(description="Sum of all rewards.")
    outcome: OutcomeName = Field(description="How it ended.")
    record: EpisodeRecord = Field(description="The flight: task, seed, agent, actions, rewards, score.")

    @classmethod
    def of(cls, episode_id: str, episode: Episode, agent: str) -> Self:
        """Return the stored form of an episode that has just ended.

        Raises:
            EpisodeError: if it has not ended.
            InvalidValueError: if the agent's name is not one printable line, or task or reward profile differ from the
                registered ones of the same name.
            UnknownNameError: if task or reward profile are not registered.
        """
        if not episode.started or not episode.ended:
            raise EpisodeError("the episode has not ended: only finished ones are stored")
        task, profile = episode.task, episode.reward_profile
        if get_task(task.id, task.version) != task or get_reward_profile(profile.id) != profile:
            raise InvalidValueError(
                f"{task.id!r} or reward profile {profile.id!r} is not the registered one, so it cannot be replayed: "
                "register it under another name"
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
    """Return the name of an agent.

    Raises:
        InvalidValueError: if it is not one printable line of 1 to 200 characters.
    """
    try:
        return AGENT_LABEL.validate_python(agent, strict=True)
    except ValidationError:
        raise InvalidValueError(
            f"an agent's name is one printable line of 1 to 200 characters, got {agent!r}"
        ) from None


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat()


class EpisodeSummary(StrictModel):
    """One row of a list of finished episodes, with the optimum of its map."""

    number: int = Field(exclude=True, description="The order of storing; it always rises.")
    id: str
    finished_at: Annotated[float, PlainSerializer(_iso, return_type=str)] = Field(description="UTC, ISO 8601.")
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
    solved: bool = Field(exclude=True, strict=False, description="Whether the solver has finished its map.")
    optimal_score: Score | None = Field(description="The optimum of its map; null if it is unknown.")

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


COLUMNS = list(EpisodeSummary.model_fields)[:-2]
SELECT_ROWS = (
    f"SELECT {', '.join([f'e.{name}' for name in COLUMNS])}, o.task IS NOT NULL AS solved, o.score AS optimal_score "
    "FROM episodes e LEFT JOIN optima o USING (task, task_version, seed)"
)
"""Selects the fields of `EpisodeSummary`."""

SELECT_BEST = f"""
    SELECT {", ".join(COLUMNS)}, 0 AS solved, NULL AS optimal_score FROM (
        SELECT *, row_number() OVER (PARTITION BY agent ORDER BY score DESC, steps, number) AS place
        FROM episodes {{where}} AND (agent = ? OR agent GLOB ? || ' (*)' AND instr(agent, ')') = length(agent))
    ) WHERE place = 1 ORDER BY score DESC, steps, number LIMIT ?
"""
"""Selects the best flight of an agent and of each of its names; `where` names one map."""

# Columns beside one max() are those of the row where it is: https://sqlite.org/lang_select.html#bareagg
SELECT_BY_MAP = """
    SELECT e.agent, task, task_version, o.task IS NOT NULL AS solved, max(e.number),
        iif(count(DISTINCT e.reward_profile) = 1, e.reward_profile, NULL) AS reward_profile, seed AS seeds,
        avg(e.score) AS scores, avg(e.steps) AS steps, avg(e.outcome = 'delivered') AS success,
        o.score AS optimal_scores, count(*) AS flights, avg(e.reward_total) AS rewards, e.id AS ids
    FROM episodes e LEFT JOIN optima o USING (task, task_version, seed) {where}
    GROUP BY e.agent, seed ORDER BY e.agent, seed
"""
"""Selects the means of each agent's flights over each map, and the id of the newest flight; `where` names one task."""
OF_RESULTS = ("seeds", "scores", "steps", "success", "optimal_scores", "flights", "rewards", "ids")
"""The columns of `SELECT_BY_MAP` that are columns of `Results`."""


def results_by_agent(rows: Iterable[sqlite3.Row]) -> dict[str, Results]:
    """Return the results of each agent, one row per map, from the rows of `SELECT_BY_MAP`."""
    found: dict[str, Results] = {}
    for agent, group in groupby(rows, key=lambda row: row["agent"]):
        maps = list(group)
        first, profiles = maps[0], {row["reward_profile"] for row in maps}
        found[agent] = Results.of_rows(
            EpisodesKey(first["task"], first["task_version"], "custom", (first["seeds"], maps[-1]["seeds"] + 1), agent),
            reward_profile=profiles.pop() if len(profiles) == 1 else None,
            **{name: [row[name] for row in maps] for name in OF_RESULTS},
        )
    return found


def digits_of(record: EpisodeRecord) -> str:
    """Return the actions of a flight as the store keeps them, one digit each."""
    return "".join([str(DIRECTIONS.index(name)) for name in record.actions])


def insert_episode(connection: sqlite3.Connection, stored: StoredEpisode) -> None:
    """Add a finished episode, unless its id is stored already."""
    columns = (*COLUMNS[1:], "episode")
    values = {
        **vars(stored.record),
        **vars(stored),
        "finished_at": stored.finished_at.timestamp(),
        "actions": digits_of(stored.record),
        "episode": stored.model_dump_json(exclude_none=True),
    }
    places = ", ".join([f":{name}" for name in columns])
    connection.execute(
        f"INSERT INTO episodes ({', '.join(columns)}) VALUES ({places}) ON CONFLICT (id) DO NOTHING", values
    )


class Analysis(StrictModel):
    """Statistics of the newest finished episodes of one task, of all agents and reward profiles; null if unknown."""

    task: str = Field(description="Id of the task.")
    episodes_total: Count = Field(description="Finished episodes of this task in the store.")
    episodes: Count = Field(description="The newest of them, which the other fields cover.")
    average_reward: float | None = Field(description="Mean of the episodes' total rewards.")
    # The bounds are not 0.01 and 0.99, since a mean of many 0.99 may be rounded up.
    average_score: float | None = Field(ge=0, le=1, description="Mean graded score.")
    success_rate: float | None = Field(ge=0, le=1, description="Share of episodes that delivered everything.")
    success_trend: float | None = Field(
        ge=-1, le=1, description="Success rate of the newer half minus that of the older half; null below two episodes."
    )
    average_steps: float | None = Field(description="Mean length in steps.")
    average_deliveries: float | None = Field(description="Mean parcels delivered.")
    deliveries: Count = Field(description="Parcels delivered in total.")
    action_distribution: dict[Direction, float] = Field(description="Share of each action; all 0 without steps.")
    mean_regret: float | None = Field(
        ge=0, description="Mean of optimum - score, over the episodes with a known optimum."
    )
    regret_episodes: Count = Field(description="Episodes with a known optimum; the solver works on the others.")


def analyse(task: TaskConfig, total: int, rows: Sequence[EpisodeSummary]) -> Analysis:
    """Return the statistics of the newest episodes of a task; every flight counts, even several over one map.

    Args:
        task: The task.
        total: Finished episodes of this task in the store.
        rows: The newest of them, newest first.
    """
    success, half, flown = [row.success for row in rows], len(rows) // 2, "".join([row.actions for row in rows])
    deliveries, regrets = [row.deliveries for row in rows], [row.regret for row in rows if row.regret is not None]
    return Analysis(
        task=task.id,
        episodes_total=total,
        episodes=len(rows),
        average_reward=mean_of([row.reward_total for row in rows]),
        average_score=mean_of([row.score for row in rows]),
        success_rate=mean_of(success),
        # An odd episode in the middle belongs to neither half.
        success_trend=(sum(success[:half]) - sum(success[-half:])) / half if half else None,
        average_steps=mean_of([row.steps for row in rows]),
        average_deliveries=mean_of(deliveries),
        deliveries=sum(deliveries),
        action_distribution={action.name: flown.count(str(int(action))) / max(len(flown), 1) for action in Action},
        mean_regret=mean_of(regrets),
        regret_episodes=len(regrets),
    )
