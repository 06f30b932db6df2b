"""The engine `ray`: `run_episodes(key)` as jobs of a cluster."""

import dataclasses
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import ray

from drone_env.agents import elsewhere, file_of
from drone_env.cluster.jobs import run_jobs
from drone_env.errors import ClusterError
from drone_env.results.evaluate import run_episodes
from drone_env.results.result import EpisodesKey, Results

TRIES = 11
"""How often a piece is flown whose node dies."""


def fly_on_nodes(keys: Sequence[EpisodesKey]) -> Iterator[Results]:
    """The results of all keys in the order in which they arrive. Inside of `connect` only.

    A node that dies has its pieces flown again elsewhere. A file that an agent's name names travels as it is: nodes
    need not have it. Modules of one's own they must find.

    Raises:
        ClusterError: if no node offers a CPU, one has another package than this one, or a piece was lost on every try.
        DroneEnvError: what `run_episodes` raises.
    """
    named = {key.agent: file_of(key.agent) for key in keys}
    files = {name: ray.put(file.read_bytes()) for name, file in named.items() if file is not None}
    for key, results in run_jobs(partial(_fly, files), keys, TRIES, _lost):
        yield dataclasses.replace(results, key=key)


def _lost(key: EpisodesKey, error: Exception) -> None:
    raise ClusterError(f"a piece was lost, flown {TRIES} times: {error}")


def _fly(files: Mapping[str, Any], key: EpisodesKey) -> Iterator[Results]:
    if key.agent not in files:
        yield run_episodes(key)
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{cast(Path, file_of(key.agent)).suffix}"
        file.write_bytes(cast(Any, ray).get(files[key.agent]))
        yield run_episodes(key._replace(agent=elsewhere(key.agent, file)))
