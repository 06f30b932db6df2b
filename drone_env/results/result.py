"""Results of flights over maps in columns: one row per flight or per map."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from drone_env.errors import InvalidValueError

MAPS_PER_CHUNK = 1000
"""Episodes per unit of work, on any engine."""
COLUMNS: dict[str, type[np.generic]] = {
    "seeds": np.int64,
    "scores": np.float64,
    "steps": np.int32,
    "deliveries": np.int32,
    "success": np.bool_,
    "optimal_scores": np.float64,
    "optimal_steps": np.int32,
}
"""The columns that an evaluation stores, and their dtypes."""


class EpisodesKey(NamedTuple):
    """Identifies results: equal keys give equal results.

    `seeds` is [start, stop); `split` is the split of the seeds, or `custom`. `config_hash` is empty if the
    configuration of the agent is unknown. `repeat` numbers the flights of a stochastic agent over one map from 0; each
    has other random numbers.
    """

    task: str
    version: int
    split: str
    seeds: tuple[int, int]
    agent: str
    config_hash: str = ""
    repeat: int = 0

    def chunks(self, size: int = MAPS_PER_CHUNK) -> list[Self]:
        """Return the keys of consecutive chunks of at most `size` episodes."""
        start, stop = self.seeds
        return [self._replace(seeds=(first, min(first + size, stop))) for first in range(start, stop, size)]


@dataclass(frozen=True)
class Result:
    """One row of `Results` as Python values; None if a value is unknown."""

    seed: int
    score: float
    success: float
    steps: float
    optimum: float | None
    flights: int
    id: str | None


@dataclass(frozen=True, eq=False)
class Results:
    """Results of one agent on one task.

    A row is a flight; after `by_map` it is a map, with the means of the flights over it.

    Attributes:
        key: The task, maps and agent.
        seeds: int64[n], the maps.
        scores: float64[n], graded scores.
        steps: int32[n], steps flown.
        deliveries: int32[n], parcels delivered.
        success: bool[n], whether all parcels were delivered.
        optimal_scores: float64[n], the exact optimum of each map; NaN if unknown.
        optimal_steps: int32[n], steps of the optimal flight; -1 if unknown.
        rewards: float64[n], total rewards; None if unknown.
        reward_profile: The profile of all rewards; None if it is unknown or they differ.
        flights: int64[n], flights behind each row; None if each row is one flight.
        ids: The id of the newest stored flight behind each row, or None; empty if none is stored.
    """

    key: EpisodesKey
    seeds: npt.NDArray[np.int64]
    scores: npt.NDArray[np.float64]
    steps: npt.NDArray[Any]
    deliveries: npt.NDArray[Any]
    success: npt.NDArray[Any]
    optimal_scores: npt.NDArray[np.float64]
    optimal_steps: npt.NDArray[np.int32]
    rewards: npt.NDArray[np.float64] | None = None
    reward_profile: str | None = None
    flights: npt.NDArray[np.int64] | None = None
    ids: Sequence[str | None] = ()

    @classmethod
    def of_rows(
        cls,
        key: EpisodesKey,
        reward_profile: str | None = None,
        ids: Sequence[str | None] = (),
        **columns: Sequence[Any],
    ) -> Self:
        """Create results from columns of Python values; deliveries and optimal steps are unknown."""
        arrays: dict[str, Any] = {
            name: np.array(values, np.float64 if name == "optimal_scores" else None) for name, values in columns.items()
        }
        unknown = np.full(len(arrays["seeds"]), -1)
        return cls(key, **arrays, deliveries=unknown, optimal_steps=unknown, reward_profile=reward_profile, ids=ids)

    def by_map(self) -> "Results":
        """Return one row per map, sorted by seed: the means of the flights over it."""
        if self.flights is not None:
            return self
        seeds, first, row, flights = np.unique(self.seeds, return_index=True, return_inverse=True, return_counts=True)
        means = {
            name: np.bincount(row, getattr(self, name), len(seeds)) / flights
            for name in ("scores", "steps", "deliveries", "success")
        }
        best = {name: getattr(self, name)[first] for name in ("optimal_scores", "optimal_steps")}
        rewards = None if self.rewards is None else np.bincount(row, self.rewards) / flights
        return replace(self, seeds=seeds, **means, **best, rewards=rewards, flights=flights, ids=())

    def take(self, rows: npt.NDArray[np.intp]) -> "Results":
        """Return some of the rows."""
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        flights, rewards = (None if column is None else column[rows] for column in (self.flights, self.rewards))
        ids: list[str | None] = [self.ids[row] for row in rows] if self.ids else []
        return replace(self, **columns, flights=flights, rewards=rewards, ids=ids)

    def rows(self) -> list[Result]:
        """Return each row as Python values."""
        n = len(self.seeds)
        columns = (self.seeds.tolist(), self.scores.tolist(), self.success.tolist(), self.steps.tolist())
        optima = [None if np.isnan(optimum) else optimum for optimum in self.optimal_scores.tolist()]
        flights = [1] * n if self.flights is None else self.flights.tolist()
        return [Result(*row) for row in zip(*columns, optima, flights, self.ids or [None] * n, strict=True)]


def concatenate(results: Sequence[Results], key: EpisodesKey) -> Results:
    """Join the rows of several results under one key."""
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in results]) for name in COLUMNS}
    return Results(key, **columns)


def repeated(repeats: Sequence[Results]) -> Results:
    """Join the repeats of one agent over the same maps.

    Raises:
        InvalidValueError: if they are not flights of one agent over the same maps.
    """
    first = repeats[0].key
    for results in repeats:
        if results.key._replace(repeat=first.repeat) != first:
            raise InvalidValueError(f"these are not flights of one agent over the same maps: {first} and {results.key}")
    return concatenate(repeats, first)


def results_by_agent(rows: Iterable[Any]) -> dict[str, Results]:
    """Return the results of each agent, one row per map, from the rows of `Store.means_by_map`."""
    found: dict[str, Results] = {}
    columns = ("seeds", "scores", "steps", "success", "optimal_scores", "flights", "rewards", "ids")
    for agent, group in groupby(rows, key=lambda row: row["agent"]):
        maps = list(group)
        first, profiles = maps[0], {row["reward_profile"] for row in maps}
        found[agent] = Results.of_rows(
            EpisodesKey(first["task"], first["task_version"], "custom", (first["seeds"], maps[-1]["seeds"] + 1), agent),
            reward_profile=profiles.pop() if len(profiles) == 1 else None,
            **{name: [row[name] for row in maps] for name in columns},
        )
    return found
