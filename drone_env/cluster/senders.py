"""`drone-env infer --engine ray`: the nodes of a cluster send the requests of a run.

Flights, rate limiter and transcript are in the driver's process, so that concurrency, rate and budget apply to the
whole run. If a node dies, its request is a failed try, and another node sends the next one.

The endpoint's token is a masked argument of each call: Ray stores and shows the arguments of actors' constructors and
runtime environments.
"""

import itertools
from collections.abc import Mapping
from typing import Any, cast

import ray
from pydantic import SecretStr
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from drone_env.cluster.nodes import Driver, check_node, failure, nodes_with_cpus, this_driver
from drone_env.errors import ClusterError
from drone_env.llm.answers import Answer
from drone_env.llm.endpoint import Endpoint, TryFailedError
from drone_env.llm.limiter import Options


class NodeSender:
    """The actor on a node. It sends many requests at once."""

    def __init__(self) -> None:
        self._endpoint: Endpoint | None = None

    async def send(
        self, driver: Driver, base_url: str, token: SecretStr | None, timeout: float, *request: Any
    ) -> Answer:
        """See `Endpoint.send`.

        Raises:
            TryFailedError: if there is no answer.
            ClusterError: if this node differs from the driver.
        """
        check_node(driver)
        if self._endpoint is None:
            self._endpoint = Endpoint(base_url, None if token is None else token.get_secret_value(), timeout)
        return await self._endpoint.send(*request)


class ClusterEndpoint:
    """An `Endpoint` whose requests the nodes send in turn. Use it inside `connect`, and close it.

    Args:
        base_url: The address of the endpoint.
        token: The API token; None to send none.
        options: Timeout and concurrency of the requests.

    Raises:
        ClusterError: if no node offers a CPU.
    """

    def __init__(self, base_url: str, token: str | None, options: Options) -> None:
        self._first = (this_driver(), base_url, None if token is None else SecretStr(token), options.timeout)
        remote: Any = cast(Any, ray).remote(num_cpus=0, max_restarts=-1, max_concurrency=options.concurrency)(
            NodeSender
        )
        # The head of a large cluster has no CPUs and sends nothing.
        self._actors = [
            remote.options(scheduling_strategy=NodeAffinitySchedulingStrategy(node, soft=True)).remote()
            for node in nodes_with_cpus()
        ]
        if not self._actors:
            raise ClusterError("no node of the cluster offers a CPU")
        self._rotation = list(self._actors)
        self._count = itertools.count()

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        """See `Endpoint.send`.

        Raises:
            TryFailedError: if there is no answer, or the node died.
            ClusterError: if a node differs from the driver, or fails.
        """
        actor = self._rotation[next(self._count) % len(self._rotation)]
        try:
            return await actor.send.remote(*self._first, request, call_id)
        except RayTaskError as error:
            raise failure(error) from None
        except RayError as error:
            # The last one stays: Ray restarts it.
            if actor in self._rotation and len(self._rotation) > 1:
                self._rotation.remove(actor)
            raise TryFailedError(0, f"the node died: {type(error).__name__}", retried=True) from None

    async def close(self) -> None:
        """End the actors."""
        for actor in self._actors:
            cast(Any, ray).kill(actor)
