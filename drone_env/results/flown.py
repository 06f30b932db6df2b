"""Results of the flights in a store."""

import sqlite3
from collections.abc import Iterable
from itertools import groupby

from drone_env.results.result import EpisodesKey, Results

COLUMNS = ("seeds", "scores", "steps", "success", "optimal_scores", "flights", "rewards", "ids")


def results_by_agent(rows: Iterable[sqlite3.Row]) -> dict[str, Results]:
    """Return the results of each agent, one row per map, from `Store.means_by_map`."""
    found: dict[str, Results] = {}
    for agent, group in groupby(rows, key=lambda row: row["agent"]):
        maps = list(group)
        first, profiles = maps[0], {row["reward_profile"] for row in maps}
        found[agent] = Results.of_rows(
            EpisodesKey(first["task"], first["task_version"], "custom", (first["seeds"], maps[-1]["seeds"] + 1), agent),
            reward_profile=profiles.pop() if len(profiles) == 1 else None,
            **{name: [row[name] for row in maps] for name in COLUMNS},
        )
    return found
