"""Finished flights for a store, flown by the agents themselves."""

import json
from pathlib import Path
from typing import Any

from drone_env.files import EVALUATIONS
from drone_env.flights.provenance import Provenance
from drone_env.flights.record import EpisodeRecord, record_of, replay
from drone_env.flights.store import Store
from drone_env.results.evaluate import episodes_key, evaluate_keys, local_engine, repeats_of
from drone_env.results.folder import ResultsFolder
from tests.api import flying
from tests.api.serving import Server


def flown(
    task: str, seed: int, agent: str, label: str | Provenance | None = None, profile: str = "tiered"
) -> EpisodeRecord:
    """The record of a whole flight, under the agent's own name or another."""
    return record_of(flying.flown(task, agent, seed=seed, profile=profile), label or agent)


def fill(folder: Path, flights: list[EpisodeRecord]) -> list[str]:
    """Store flights, oldest first, with the optima of their maps, and return their ids."""
    with Store(folder) as store:
        ids = [store.add_episode(replay(flight), flight.provenance) for flight in flights]
        store.listed(len(ids))
        return ids


def put_evaluation(data: Path, name: str, agent: str, maps: range, task: str = "easy", repeats: int = 1) -> Path:
    """The evaluation of an agent in a data folder."""
    folder = data / EVALUATIONS / name
    keys = repeats_of(episodes_key(task, agent, maps), repeats)
    evaluate_keys(keys, local_engine, ResultsFolder(folder, keys))
    return folder


def get(server: Server, path: str, **query: Any) -> Any:
    """What a server answers to a question."""
    return server.client.get(f"/{path}", params=query).raise_for_status().json()


def newest(server: Server, seed: int, task: str = "easy") -> dict[str, Any]:
    """The newest stored flight over a map."""
    return next(one for one in get(server, "episodes", task=task)["episodes"] if one["seed"] == seed)


def posted(server: Server, path: str, record: EpisodeRecord) -> dict[str, Any]:
    """What a server answers to a flight."""
    return server.client.post(f"/{path}", json=json.loads(record.to_json())).raise_for_status().json()


def frames(server: Server, record: EpisodeRecord) -> list[dict[str, Any]]:
    """The frames of a flight, as a server answers them."""
    return posted(server, "replay", record)["frames"]
