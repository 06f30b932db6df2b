"""Flights as a manifest tells them, and what else artefacts are compared by."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents import make_agent
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task

HERE = Path(__file__).parent
MANIFEST = "manifest.json"
LETTERS = "UDLRW"
"""One for each action, in the order of their numbers."""


def flight_of(episode: Episode, agent: str) -> dict[str, Any]:
    """An episode as the manifest tells it."""
    return {
        "task": episode.task.id,
        "task_version": episode.task.version,
        "seed": episode.seed,
        "agent": agent,
        "reward_profile": episode.reward_profile.id,
        "actions": "".join(LETTERS[action] for action in episode.actions),
        "deliveries": episode.deliveries_done,
        "reward_total": episode.reward_total,
        "score": episode.score,
        "outcome": episode.outcome.name.lower(),
    }


def flown(flight: dict[str, Any], steps: int | None = None) -> Episode:
    """The episode of a manifest's flight, flown again; its first so many steps."""
    episode = Episode(get_task(flight["task"], flight["task_version"]), flight["reward_profile"])
    episode.reset(flight["seed"])
    for letter in flight["actions"][:steps]:
        episode.step(LETTERS.index(letter))
    return episode


def fly(task: str, seed: int, agent: str, reward_profile: str = "tiered") -> dict[str, Any]:
    """A flight of an agent to its end."""
    episode, pilot = Episode(task, reward_profile), make_agent(agent, task)
    pilot.reset(episode.reset(seed))
    while not episode.ended:
        episode.step(pilot.act(episode.observation()))
    return flight_of(episode, agent)


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder but the manifest, 16 hex digits each."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / MANIFEST)
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()[:16] for path in files}


def judged(values: Any, seeds: Sequence[int]) -> list[list[float]]:
    """What a network, `values(grids, telemetry)`, makes of the starts of easy maps: the values of the five actions."""
    episode = Episode(get_task("easy_delivery", 1))
    rows: list[list[float]] = []
    for seed in seeds:
        episode.reset(seed)
        seen = episode.observation()
        rows.append(np.asarray(values(seen["grid"][None], seen["telemetry"][None]))[0].tolist())
    return rows


def fly_surely(values: Any) -> list[dict[str, Any]]:
    """Three flights of a network over test maps on which no two values are so near that another processor's last bits
    might fly them otherwise.
    """
    flights: list[dict[str, Any]] = []
    for seed in split_seeds("test", 1000):
        episode = Episode(get_task("easy_delivery", 1))
        episode.reset(seed)
        sure = True
        while sure and not episode.ended:
            seen = episode.observation()
            row = values(seen["grid"][None], seen["telemetry"][None])[0]
            *_, second, first = sorted(row.tolist())
            sure = first - second > 1e-3
            episode.step(int(row.argmax()))
        if sure:
            flights.append(flight_of(episode, "pathqnet"))
        if len(flights) == 3:
            return flights
    raise SystemExit("no three flights of the network are sure")
