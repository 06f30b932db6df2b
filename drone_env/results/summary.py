"""Figures of the finished episodes of a task."""

import math
from collections.abc import Sequence

from pydantic import Field

from drone_env.core.actions import Action
from drone_env.models import Count, Direction, Message
from drone_env.results.finished import EpisodeSummary


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


def analyse(task: str, total: int, rows: Sequence[EpisodeSummary]) -> Analysis:
    """The figures of the newest episodes of a task.

    Args:
        task: Id of the task.
        total: Finished episodes of this task in the store.
        rows: The newest of them, newest first.
    """
    wins = [row.success for row in rows]
    half = len(rows) // 2
    flown = "".join([row.actions for row in rows])
    regrets = [row.regret for row in rows if row.regret is not None]
    return Analysis(
        task=task,
        episodes_total=total,
        episodes=len(rows),
        average_reward=_mean([row.reward_total for row in rows]),
        average_score=_mean([row.score for row in rows]),
        success_rate=_mean(wins),
        # An odd episode in the middle belongs to neither half.
        success_trend=(sum(wins[:half]) - sum(wins[-half:])) / half if half else None,
        average_steps=_mean([row.steps for row in rows]),
        average_deliveries=_mean([row.deliveries for row in rows]),
        deliveries=sum(row.deliveries for row in rows),
        action_distribution={action.name: flown.count(str(int(action))) / max(len(flown), 1) for action in Action},
        mean_regret=_mean(regrets),
        regret_episodes=len(regrets),
    )


def _mean(values: Sequence[float]) -> float | None:
    return math.fsum(values) / len(values) if values else None
