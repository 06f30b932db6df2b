"""The finished episodes of a task, put together by agent and map."""

from collections.abc import Sequence
from typing import Any, NamedTuple


class FlownMap(NamedTuple):
    """All flights of one agent over one map."""

    agent: str
    task: str
    task_version: int
    seed: int
    flights: int
    id: str | None
    """The newest of them in the store; None where none is kept there."""
    score: float
    """Mean graded score, as all that follow are means."""
    success: float
    """Share of the flights that delivered everything."""
    steps: float
    reward: float
    """Mean total reward."""
    reward_profile: str | None
    """What all of them were paid by; None where they differ."""
    solved: bool
    """Whether the map has been given to the solver."""
    optimum: float | None
    """The highest score that any flight over the map reaches; None where it is not known."""


# Columns beside one max() are those of the row where it is: https://sqlite.org/lang_select.html#bareagg
SELECT_BY_MAP = """
    SELECT e.agent, task, task_version, seed, count(*), e.id, avg(e.score), avg(e.outcome = 'delivered'), avg(e.steps),
        avg(e.reward_total), iif(count(DISTINCT e.reward_profile) = 1, e.reward_profile, NULL),
        o.task IS NOT NULL, o.score, max(e.number)
    FROM episodes e LEFT JOIN optima o USING (task, task_version, seed) {where}
    GROUP BY e.agent, seed ORDER BY e.agent, seed
"""
"""With the WHERE of the episodes that are meant, of one task."""


def flown_map(row: Sequence[Any]) -> FlownMap:
    """What a row of `SELECT_BY_MAP` says."""
    return FlownMap(*row[:-1])
