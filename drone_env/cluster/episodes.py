"""The engine `ray`: run `run_episodes(key)` as tasks on the nodes of a cluster."""

import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, cast

import ray
from ray.exceptions import RayError, RayTaskError

from drone_env.agents import file_of, rebase_agent_path
from drone_env.cluster.nodes import Driver, check_node, failure, nodes_with_cpus, this_driver
from drone_env.errors import ClusterError
from drone_env.results.evaluate import run_episodes
from drone_env.results.result import EpisodesKey, Results

RETRIES = 10
"""Maximum number of retries of a chunk whose node dies."""
AHEAD = 2
"""Submitted chunks per CPU, so that no CPU waits for the driver."""


def fly_on_nodes(keys: Sequence[EpisodesKey]) -> Iterator[Results]:
    """Yield the results of all keys in order of arrival. Use it inside `connect`.

    A file in an agent's name is sent to the nodes. Your own modules must exist on every node.

    Raises:
        ClusterError: if no node offers a CPU, a node has another version of this package or fails, or a chunk is lost
            on every try.
        DroneEnvError: if `run_episodes` raises it.
    """
    if not nodes_with_cpus():
        raise ClusterError("no node of the cluster offers a CPU")
    files = {key.agent: file_of(key.agent) for key in keys}
    contents = {agent: ray.put(file.read_bytes()) for agent, file in files.items() if file is not None}
    fly: Any = cast(Any, ray).remote(num_cpus=1, max_retries=RETRIES)(_fly)
    driver, remaining = this_driver(), iter(keys)
    pending: dict[Any, EpisodesKey] = {}
    while True:
        room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1))) - len(pending)
        for key in islice(remaining, max(0, room)):
            pending[fly.remote(driver, key, contents.get(key.agent))] = key
        if not pending:
            return
        for task in cast(Any, ray).wait(list(pending))[0]:
            key = pending.pop(task)
            try:
                results = cast(Any, ray).get(task)
            except RayTaskError as error:
                raise failure(error) from None
            except RayError as error:
                raise ClusterError(f"a chunk was lost, flown {1 + RETRIES} times: {error}") from None
            yield dataclasses.replace(results, key=key)


def _fly(driver: Driver, key: EpisodesKey, content: bytes | None) -> Results:
    check_node(driver)
    if content is None:
        return run_episodes(key)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{cast(Path, file_of(key.agent)).suffix}"
        file.write_bytes(content)
        return run_episodes(key._replace(agent=rebase_agent_path(key.agent, file)))
