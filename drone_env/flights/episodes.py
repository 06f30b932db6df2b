"""Finished episodes: the whole episode, rows for lists, means by agent and map, statistics of a task."""

import json
import sqlite3
from collections.abc import Sequence
from datetime import datetime, timezone
from statistics import fmean
from typing import Annotated, Literal, cast

from pydantic import Field, PlainSerializer, computed_field
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.flights.provenance import Provenance
from drone_env.flights.record import EpisodeRecord, record_of
from drone_env.models import Count, Direction, OutcomeName, Score, Seed, StrictModel


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
    def of(cls, episode_id: str, finished_at: float, episode: Episode, provenance: Provenance) -> Self:
        """Return the stored form of an episode that has ended."""
        return cls(
            id=episode_id,
            finished_at=datetime.fromtimestamp(finished_at, timezone.utc),
            steps=episode.steps,
            deliveries_total=episode.task.deliveries,
            reward_total=episode.reward_total,
            outcome=cast(OutcomeName, episode.outcome.name.lower()),
            record=record_of(episode, provenance),
        )


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat()


class EpisodeSummary(Provenance):
    """One row of a list of finished episodes, with the optimum of its map."""

    number: int = Field(exclude=True, description="The order of storing; it always rises.")
    id: str
    finished_at: Annotated[float, PlainSerializer(_iso, return_type=str)] = Field(description="UTC, ISO 8601.")
    task: str
    task_version: int
    seed: Seed
    reward_profile: str
    agent: str = Field(description="Who flew, in words.")
    actions: str = Field(exclude=True, description="One digit per action.")
    deliveries: Count
    deliveries_total: Count
    steps: Count
    reward_total: float
    score: Score
    outcome: str
    solved: bool = Field(exclude=True, description="Whether the solver has finished its map.")
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


def summary_of(row: sqlite3.Row) -> EpisodeSummary:
    """Return a row of `SELECT_ROWS`."""
    parent = None if row["parent"] is None else json.loads(row["parent"])
    return EpisodeSummary.model_validate({**row, "parent": parent}, strict=False)


COLUMNS = list(EpisodeSummary.model_fields)[:-2]
SELECT_ROWS = (
    f"SELECT {', '.join([f'e.{name}' for name in COLUMNS])}, o.task IS NOT NULL AS solved, o.score AS optimal_score "
    "FROM flights e LEFT JOIN optima o USING (task, task_version, seed)"
)
"""Selects the fields of `EpisodeSummary`."""

SELECT_BEST = f"""
    SELECT {", ".join(COLUMNS)}, 0 AS solved, NULL AS optimal_score FROM (
        SELECT *, row_number() OVER (PARTITION BY person ORDER BY score DESC, steps, number) AS place
        FROM flights {{where}} AND parent IS NULL
    ) WHERE place = 1 ORDER BY score DESC, steps, number LIMIT ?
"""
"""Selects the best flight of each person; `where` names one map and flights by hand."""

# Columns beside one max() are those of the row where it is: https://sqlite.org/lang_select.html#bareagg
SELECT_BY_MAP = """
    SELECT e.agent, e.pilot, e.person, e.values_used, e.undo_used, e.parent, task, task_version,
        o.task IS NOT NULL AS solved, max(e.number),
        iif(count(DISTINCT e.reward_profile) = 1, e.reward_profile, NULL) AS reward_profile, seed AS seeds,
        avg(e.score) AS scores, avg(e.steps) AS steps, avg(e.outcome = 'delivered') AS success,
        o.score AS optimal_scores, count(*) AS flights, avg(e.reward_total) AS rewards, e.id AS ids
    FROM flights e LEFT JOIN optima o USING (task, task_version, seed) {where}
    GROUP BY e.agent, seed ORDER BY e.agent, seed
"""
"""Selects the means of each agent's flights over each map, and the id of the newest flight; `where` names one task."""


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
    status: Literal["Success", "No data"] = Field(description="Whether there are any episodes.")


def _mean(values: Sequence[float]) -> float | None:
    return fmean(values) if values else None


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
        average_reward=_mean([row.reward_total for row in rows]),
        average_score=_mean([row.score for row in rows]),
        success_rate=_mean(success),
        # An odd episode in the middle belongs to neither half.
        success_trend=(sum(success[:half]) - sum(success[-half:])) / half if half else None,
        average_steps=_mean([row.steps for row in rows]),
        average_deliveries=_mean(deliveries),
        deliveries=sum(deliveries),
        action_distribution={action.name: flown.count(str(int(action))) / max(len(flown), 1) for action in Action},
        mean_regret=_mean(regrets),
        regret_episodes=len(regrets),
        status="Success" if rows else "No data",
    )
