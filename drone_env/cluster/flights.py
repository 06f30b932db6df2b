"""`drone-env infer --engine ray`: flights and their requests on all nodes, one desk for all of them.

The desk is an actor on the driver's machine, where the run folder is. It alone writes the transcript, and it alone lets
requests through, so that concurrency, pace and limits are those of the whole run. A flyer is an actor on each node. A
flight goes on from an answer only when the desk has acknowledged that it is in the transcript; one whose node dies
begins again elsewhere, and finds there what has been paid.

The endpoint's token travels from the driver to each flyer as a value of a call, masked wherever it would be printed:
not as an argument of an actor's making, and not in a runtime environment, which Ray keeps and shows.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Literal, cast

import ray
from pydantic import SecretStr
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from drone_env.cluster.jobs import failure
from drone_env.cluster.nodes import Driver, check_node, this_driver
from drone_env.errors import ClusterError
from drone_env.llm.caller import Caller
from drone_env.llm.config import RunConfig
from drone_env.llm.desk import Desk
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.gate import Gate
from drone_env.llm.options import Options
from drone_env.llm.pilot import PilotedEpisode, fly_one
from drone_env.llm.run_folder import TRANSCRIPT, RunFolder
from drone_env.llm.runner import Observer, RunResult, fly_all, result_of
from drone_env.llm.transcript import Call, Transcript

TRIES = 10
"""How often a flight is begun again whose node dies."""
NEWS_SECONDS = 0.5


class News:
    """What the driver's observer is to hear: the name of a method, and its arguments."""

    def __init__(self) -> None:
        self.items: list[tuple[Literal["called", "waiting"], tuple[Any, ...]]] = []

    def called(self, call: Call) -> None:
        """A call was made."""
        self.items.append(("called", (call,)))

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed."""
        self.items.append(("waiting", (seconds, reason)))


class DeskActor:
    """Holds the desk of a run, for flyers elsewhere."""

    async def open(self, folder: str, config: RunConfig, options: Options) -> list[Call]:
        """Open the transcript and return its calls so far."""
        self._transcript = Transcript(Path(folder) / TRANSCRIPT)
        self._gate, self._news = Gate(options), News()
        earlier = list(self._transcript.calls)
        self._desk = Desk(config, self._transcript, self._gate, self._news)
        return earlier

    async def do(self, name: str, *arguments: Any, **named: Any) -> Any:
        """Call a method of the desk."""
        return await getattr(self._desk, name)(*arguments, **named)

    async def news(self) -> tuple[list[tuple[str, tuple[Any, ...]]], int, Exception | None]:
        """What happened since the last time, requests under way, and why no further call makes sense."""
        items, self._news.items = self._news.items, []
        return cast(Any, items), self._gate.active, self._gate.fatal

    async def close(self) -> None:
        """Put all on the disk."""
        self._transcript.close()


class RemoteDesk:
    """The desk, seen from a flyer: each of its methods, called where it stands."""

    def __init__(self, actor: Any) -> None:
        self._actor = actor

    def __getattr__(self, name: str) -> Callable[..., Awaitable[Any]]:
        return lambda *arguments, **named: _result(self._actor.do.remote(name, *arguments, **named))


class Flyer:
    """Flies flights of a run on one node, many at once."""

    def __init__(self) -> None:
        # Nothing is handed over here: Ray can restart an actor only as long as it has what it was made from.
        self._caller: Caller | None = None

    async def fly(
        self, driver: Driver, desk: Any, config: RunConfig, options: Options, token: SecretStr | None, index: int
    ) -> PilotedEpisode:
        """Fly one episode.

        Raises:
            StoppedError: if the run is being stopped.
            ClusterError: if this node has another package than the driver.
        """
        check_node(driver)
        if self._caller is None:
            endpoint = Endpoint(config, None if token is None else token.get_secret_value(), options.timeout)
            self._caller = Caller(config, endpoint, cast(Desk, RemoteDesk(desk)), options)
        return await fly_one(config, index, self._caller.ask, options.server)


async def run_on_nodes(
    config: RunConfig, folder: RunFolder, token: str | None, gate: Gate, observer: Observer
) -> RunResult:
    """What `runner.run` does, on all nodes of the cluster. Inside of `connect` only.

    Requests pass a gate at the desk; the one that is given counts their tokens and cost.

    Raises:
        OSError: if the folder cannot be written to.
        InvalidValueError: if the transcript is damaged or of another run.
        ClusterError: if a node has another package than this one, or flights were lost again and again.
    """
    options = gate.options
    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    desk = _actor(DeskActor, options, scheduling_strategy=here, num_cpus=0)
    secret = None if token is None else SecretStr(token)
    for call in cast(list[Call], await _result(desk.open.remote(str(folder.path.resolve()), config, options))):
        gate.count(call)
    nodes = [node for node in cast(list[dict[str, Any]], ray.nodes()) if node["Alive"]]
    # A node that offers no CPU, as the head of a large cluster should, is left alone where others do.
    flyers = [
        _actor(
            Flyer,
            options,
            scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=True),
            num_cpus=0,
            max_restarts=-1,
            max_task_retries=TRIES,
        )
        for node in [node for node in nodes if node["Resources"].get("CPU")] or nodes
    ]

    async def tell() -> None:
        items, gate.active, gate.fatal = await _result(desk.news.remote())
        for name, arguments in items:
            if name == "called":
                gate.count(*arguments)
            getattr(observer, name)(*arguments)

    async def keep_telling() -> None:
        while True:
            await tell()
            await asyncio.sleep(NEWS_SECONDS)

    async def fly_there(index: int) -> PilotedEpisode:
        flyer = flyers[index % len(flyers)]
        return await _result(flyer.fly.remote(this_driver(), desk, config, options, secret, index))

    telling = asyncio.ensure_future(keep_telling())
    try:
        flights = await fly_all(config, folder, gate, observer, fly_there)
        await tell()
    finally:
        telling.cancel()
        await asyncio.gather(telling, return_exceptions=True)
        for flyer in flyers:
            ray.kill(flyer)
        with contextlib.suppress(RayError):
            # It was in the file before it counted; what is left is to have it on the disk.
            await desk.close.remote()
        ray.kill(desk)
    return result_of(config, flights, gate)


def _actor(kind: type, options: Options, **settings: Any) -> Any:
    # All flights may ask at once, and the driver besides.
    remote: Any = cast(Any, ray).remote(max_concurrency=4 * options.concurrency + 100, **settings)(kind)
    return remote.remote()


async def _result(reference: Awaitable[Any]) -> Any:
    """What a call brings, or raises."""
    try:
        return await reference
    except RayTaskError as error:
        raise failure(error) from None
    except RayError as error:
        raise ClusterError(f"a part of the run was lost: {error}") from None
