"""Agents beside each other: over all maps that each flew, and two of them map by map.

Of several flights of an agent over one map the mean counts, so that each map counts once. Intervals are over maps.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

import numpy as np
from pydantic import Field

from drone_env.models import Count, Message, Seed
from drone_env.results.by_map import FlownMap
from drone_env.results.evaluate import EpisodeResults
from drone_env.results.interval import DIFFERENCES, REGRETS, SCORES, SHARES, ci95

Bounds = list[float] | None
SAME = 1e-9
"""Scores that differ by less are equal: a mean of equal scores may be rounded."""


class Standing(Message):
    """One agent over the maps of a task that it flew. Means are over maps; intervals (95 %) are null for one map."""

    agent: str
    flights: Count
    maps: Count = Field(description="How many different maps.")
    success_rate: float = Field(ge=0, le=1, description="Share of flights that delivered everything.")
    success_ci95: Bounds
    score: float = Field(ge=0, le=1, description="Mean graded score.")
    score_ci95: Bounds
    regret: float | None = Field(description="Mean of optimum - score, over the maps whose optimum is known.")
    regret_ci95: Bounds
    regret_maps: Count = Field(description="How many these are; the others are being solved, or too large for it.")
    steps: float = Field(description="Mean length in steps.")
    reward: float | None = Field(description="Mean total reward; null where not all flights were paid alike.")
    reward_profile: str | None = Field(description="What they were paid by; null likewise.")


def standings(flown: Sequence[FlownMap]) -> list[Standing]:
    """How agents stand: who lost least first, then who did over more maps.

    Each flew maps of its own choice, and a map on which little can be won says nothing about who flew it: what was lost
    is counted from the optimum of the same map. Who flew none whose optimum is known stands last.

    Args:
        flown: Of one task: a row for each agent and map.
    """
    by_agent: dict[str, list[FlownMap]] = defaultdict(list)
    for row in flown:
        by_agent[row.agent].append(row)
    return sorted((_standing(agent, rows) for agent, rows in by_agent.items()), key=_merit)


def _merit(standing: Standing) -> tuple[float, int, str]:
    lost = math.inf if standing.regret is None else standing.regret
    return round(lost, 9), -standing.maps, standing.agent


def _standing(agent: str, rows: Sequence[FlownMap]) -> Standing:
    success, score = [row.success for row in rows], [row.score for row in rows]
    regret = [row.optimum - row.score for row in rows if row.optimum is not None]
    profiles = {row.reward_profile for row in rows}
    profile = profiles.pop() if len(profiles) == 1 else None
    return Standing(
        agent=agent,
        flights=sum(row.flights for row in rows),
        maps=len(rows),
        success_rate=fmean(success),
        success_ci95=ci95(success, SHARES),
        score=fmean(score),
        score_ci95=ci95(score, SCORES),
        regret=fmean(regret) if regret else None,
        regret_ci95=ci95(regret, REGRETS),
        regret_maps=len(regret),
        steps=fmean([row.steps for row in rows]),
        reward=None if profile is None else fmean([row.reward for row in rows]),
        reward_profile=profile,
    )


class MapFigures(Message):
    """The flights of one agent over one map; figures are their means."""

    id: str | None = Field(description="The newest of them in the store; null where it has none.")
    flights: Count
    score: float = Field(ge=0, le=1)
    steps: float
    success: float = Field(ge=0, le=1, description="Share of them that delivered everything.")


class AgentMap(MapFigures):
    """The same with the map."""

    seed: Seed
    optimum: float | None = Field(description="The highest score that any flight over it reaches; null if not known.")


class PairedMap(Message):
    """One map that both agents flew."""

    seed: Seed
    optimum: float | None = Field(description="The highest score that any flight over it reaches; null if not known.")
    difference: float = Field(description="The score of a less that of b.")
    a: MapFigures
    b: MapFigures


class Pairing(Message):
    """Two agents over the maps that both flew."""

    maps: Count
    difference: float | None = Field(description="Mean over these maps of a's score less b's; null without any map.")
    ci95: Bounds = Field(description="Its interval (95 %); null for fewer than two maps.")
    wins: Count = Field(description="Maps on which a scored more.")
    ties: Count
    losses: Count
    pairs: list[PairedMap] = Field(description="Map by map, by number.")


def agent_map(row: FlownMap) -> AgentMap:
    """What is told of an agent's flights over a map."""
    return AgentMap(**dict(_figures(row)), seed=row.seed, optimum=row.optimum)


def paired(flown: Sequence[FlownMap], a: str, b: str) -> Pairing:
    """Two agents over the maps that both flew.

    Args:
        flown: Of one task: a row for each agent and map.
        a: One agent.
        b: The other.
    """
    ours, theirs = ({row.seed: row for row in flown if row.agent == agent} for agent in (a, b))
    pairs = [
        PairedMap(
            seed=seed,
            optimum=row.optimum,
            difference=row.score - theirs[seed].score,
            a=_figures(row),
            b=_figures(theirs[seed]),
        )
        for seed, row in sorted(ours.items())
        if seed in theirs
    ]
    differences = [pair.difference for pair in pairs]
    ties = sum(abs(difference) < SAME for difference in differences)
    wins = sum(difference >= SAME for difference in differences)
    return Pairing(
        maps=len(pairs),
        difference=fmean(differences) if pairs else None,
        ci95=ci95(differences, DIFFERENCES),
        wins=wins,
        ties=ties,
        losses=len(pairs) - wins - ties,
        pairs=pairs,
    )


def flown_maps(agent: str, repeats: Sequence[EpisodeResults]) -> list[FlownMap]:
    """The maps that were flown in an evaluation.

    Args:
        agent: What to call who flew.
        repeats: The results of each flight over the maps, one or more.
    """
    first = repeats[0]
    scores, success, steps = (
        np.mean([getattr(results, name) for results in repeats], axis=0).tolist()
        for name in ("scores", "success", "steps")
    )
    return [
        FlownMap(
            agent=agent,
            task=first.key.task,
            task_version=first.key.version,
            seed=seed,
            flights=len(repeats),
            id=None,
            score=scores[i],
            success=success[i],
            steps=steps[i],
            reward=0.0,
            reward_profile=None,
            solved=True,
            optimum=None if np.isnan(first.optimal_scores[i]) else float(first.optimal_scores[i]),
        )
        for i, seed in enumerate(first.seeds.tolist())
    ]


def kept_maps(agent: str, figures: Mapping[str, Any]) -> list[FlownMap]:
    """The maps of what stands on a leaderboard.

    Args:
        agent: What to call who flew.
        figures: As `Judged` of `drone_env.results.leaderboard` holds them.
    """
    config = figures["config"]
    return [
        FlownMap(
            agent=agent,
            task=config["task"],
            task_version=config["task_version"],
            seed=of_map["seed"],
            flights=len(of_map["scores"]),
            id=None,
            score=fmean(of_map["scores"]),
            success=of_map["success"] / len(of_map["scores"]),
            steps=fmean(of_map["steps"]),
            reward=0.0,
            reward_profile=None,
            solved=True,
            optimum=of_map["optimum"],
        )
        for of_map in figures["maps"]
    ]


def _figures(row: FlownMap) -> MapFigures:
    return MapFigures(id=row.id, flights=row.flights, score=row.score, steps=row.steps, success=row.success)
