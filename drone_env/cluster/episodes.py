"""The engine `ray`: `run_episodes(key)` as tasks of a cluster."""

import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import ray
from ray.exceptions import RayError, RayTaskError

from drone_env.agents import NETWORK_PREFIX
from drone_env.cluster.nodes import Driver, check_cpus, check_node, this_driver
from drone_env.errors import ClusterError, DroneEnvError
from drone_env.evaluation.episodes import EpisodeResults, EpisodesKey, run_episodes

TRIES = 10
"""How often a piece is flown again whose node dies."""
AHEAD = 2
"""Pieces handed out for each CPU of the cluster, so that none waits for the driver."""


def fly_on_nodes(keys: Sequence[EpisodesKey]) -> Iterator[EpisodeResults]:
    """The results of all keys in the order in which they arrive. Inside of `connect` only.

    A node that dies has its pieces flown again elsewhere. The network of `pathqnet:FILE` travels as it is: nodes need
    not have the file.

    Raises:
        ClusterError: if no node offers a CPU, one has another package than this one, or a piece failed on every try.
        DroneEnvError: what `run_episodes` raises.
    """
    check_cpus(1)
    files = {key.agent for key in keys if key.agent.startswith(NETWORK_PREFIX)}
    networks = {agent: ray.put(Path(agent.removeprefix(NETWORK_PREFIX)).read_bytes()) for agent in files}
    remote: Any = ray.remote(num_cpus=1, max_retries=TRIES)(_fly)
    driver, waiting = this_driver(), iter(keys)
    under_way: dict[Any, EpisodesKey] = {}
    while True:
        most = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        while len(under_way) < most and (key := next(waiting, None)) is not None:
            under_way[remote.remote(driver, tuple(key), networks.get(key.agent))] = key
        if not under_way:
            return
        done: list[Any] = cast(Any, ray).wait(list(under_way))[0]
        for reference in done:
            key = under_way.pop(reference)
            yield dataclasses.replace(_get(reference), key=key)


def _get(reference: Any) -> EpisodeResults:
    try:
        return cast(Any, ray).get(reference)
    except RayTaskError as error:
        cause: Any = error.cause
        if isinstance(cause, DroneEnvError):
            raise cause from None
        raise ClusterError(f"a piece failed on a node: {error}") from None
    except RayError as error:
        raise ClusterError(f"a piece was lost, {TRIES} times flown again: {error}") from None


def _fly(driver: Driver, fields: tuple[Any, ...], network: bytes | None) -> EpisodeResults:
    check_node(driver)
    key = EpisodesKey(*fields)
    if network is None:
        return run_episodes(key)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "network.npz"
        file.write_bytes(network)
        return run_episodes(key._replace(agent=f"{NETWORK_PREFIX}{file}"))
