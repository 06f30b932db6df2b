"""`drone-env infer --engine ray`: flights and their requests on all nodes, one desk for all of them.

The desk is an actor on the driver's machine, where the run folder is. It alone writes the transcript, and it alone lets
requests through, so that concurrency, pace and limits are those of the whole run. A flyer is an actor on each node. A
flight goes on from an answer only when the desk has acknowledged that it is in the transcript; one whose node dies
begins anew elsewhere, and finds there what has been paid.

The endpoint's token travels from the driver to the desk and from there to each flyer as a value of a call, masked
wherever it would be printed: not as an argument of an actor's making, and not in a runtime environment, which Ray keeps
and shows.
"""

import asyncio
import contextlib
from collections.abc import Awaitable
from pathlib import Path
from typing import Any, cast

import ray
from pydantic import SecretStr
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from drone_env.cluster.nodes import Driver, check_node, this_driver
from drone_env.errors import ClusterError, DroneEnvError
from drone_env.llm.caller import Caller
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.config import RunConfig
from drone_env.llm.desk import Known, StoppedError
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.image import ServerFlight
from drone_env.llm.limits import Spending
from drone_env.llm.pilot import Flight, fly, mission_of
from drone_env.llm.run_folder import TRANSCRIPT, RunFolder
from drone_env.llm.runner import Observer, Options, RunResult, do_all, open_desk, result_of
from drone_env.llm.transcript import Call, CallKey, Transcript

TRIES = 10
"""How often a flight is begun anew whose node dies."""
NEWS_SECONDS = 0.5


class News:
    """What the driver's observer is told: (calls, waits, requests at once)."""

    def __init__(self) -> None:
        self.calls: list[Call] = []
        self.waits: list[tuple[float, str]] = []

    def called(self, call: Call) -> None:
        """A call was made."""
        self.calls.append(call)

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed."""
        self.waits.append((seconds, reason))


class DeskActor:
    """The desk of a run, for flyers elsewhere."""

    async def open(self, folder: str, config: RunConfig, options: Options, token: SecretStr | None) -> list[Call]:
        """Open the transcript and return its calls so far."""
        self._token = token
        secret = None if token is None else token.get_secret_value()
        self._transcript = Transcript(Path(folder) / TRANSCRIPT, secret)
        self._gate = AdaptiveGate(options.concurrency)
        self._news = News()
        spending = Spending(options.limits, options.prices)
        earlier = list(self._transcript.calls)
        self._desk = open_desk(config, self._transcript, spending, self._gate, options, self._news)
        return earlier

    async def token(self) -> SecretStr | None:
        """What authorises."""
        return self._token

    async def news(self) -> tuple[list[Call], list[tuple[float, str]], int, str | None]:
        """Calls and waits since the last time, requests under way, and why no further call makes sense."""
        calls, waits = self._news.calls, self._news.waits
        self._news.calls, self._news.waits = [], []
        return calls, waits, self._gate.active, None if self._desk.fatal is None else str(self._desk.fatal)

    async def close(self) -> None:
        """Put all on the disk."""
        self._transcript.close()

    async def known(self, key: CallKey, request: str, cache_key: str) -> Known:
        """See `Desk`."""
        return await self._desk.known(key, request, cache_key)

    async def enter(self, key: CallKey) -> float:
        """See `Desk`."""
        return await self._desk.enter(key)

    async def leave(self, key: CallKey, answered: bool, overloaded: bool, pause: float) -> None:
        """See `Desk`."""
        await self._desk.leave(key, answered, overloaded, pause)

    async def record(self, call: Call, cache_key: str) -> Call:
        """See `Desk`."""
        return await self._desk.record(call, cache_key)

    async def failed(self, status: int, reason: str, retried: bool, fatal: bool) -> None:
        """See `Desk`."""
        await self._desk.failed(status, reason, retried, fatal)

    async def waiting(self, seconds: float, reason: str) -> None:
        """See `Desk`."""
        self._desk.waiting(seconds, reason)


class RemoteDesk:
    """The desk, seen from a flyer."""

    def __init__(self, actor: Any) -> None:
        self._actor = actor

    async def known(self, key: CallKey, request: str, cache_key: str) -> Known:
        """See `Desk`."""
        return await _result(self._actor.known.remote(key, request, cache_key))

    async def enter(self, key: CallKey) -> float:
        """See `Desk`."""
        return await _result(self._actor.enter.remote(key))

    async def leave(self, key: CallKey, answered: bool, overloaded: bool = False, pause: float = 0.0) -> None:
        """See `Desk`."""
        await _result(self._actor.leave.remote(key, answered, overloaded, pause))

    async def record(self, call: Call, cache_key: str) -> Call:
        """See `Desk`."""
        return await _result(self._actor.record.remote(call, cache_key))

    async def failed(self, status: int, reason: str, retried: bool, fatal: bool) -> None:
        """See `Desk`."""
        await _result(self._actor.failed.remote(status, reason, retried, fatal))

    def waiting(self, seconds: float, reason: str) -> None:
        """See `Desk`."""
        self._actor.waiting.remote(seconds, reason)


class Flyer:
    """Flies flights of a run on one node, many at once."""

    def __init__(self) -> None:
        # Nothing is handed over here: Ray can make an actor anew only as long as it has what it was made from.
        self._opening = asyncio.Lock()
        self._caller: Caller | None = None

    async def fly(self, driver: Driver, desk: Any, config: RunConfig, options: Options, index: int) -> Flight | None:
        """A flight; None if the run is being stopped.

        Raises:
            ClusterError: if this node has another package than the driver.
        """
        check_node(driver)
        prompt = config.load_prompt()
        async with self._opening:
            if self._caller is None:
                secret: SecretStr | None = await _result(desk.token.remote())
                token = None if secret is None else secret.get_secret_value()
                endpoint = Endpoint(config, token, prompt.plan, options.timeout)
                self._caller = Caller(config, prompt.plan, endpoint, RemoteDesk(desk), options.retries)
        server = None if options.server is None else ServerFlight(options.server)
        try:
            return await fly(mission_of(config, index), prompt, self._caller.ask, server)
        except StoppedError:
            return None
        finally:
            if server is not None:
                server.close()


async def run_on_nodes(
    config: RunConfig, folder: RunFolder, token: str | None, options: Options, observer: Observer
) -> RunResult:
    """What `runner.run` does, on all nodes of the cluster. Inside of `connect` only.

    Raises:
        OSError: if the folder cannot be written to.
        InvalidValueError: if the transcript is damaged or of another run.
        ClusterError: if a node has another package than this one, or flights were lost again and again.
    """
    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    desk = _actor(DeskActor, options, scheduling_strategy=here, num_cpus=0)
    secret = None if token is None else SecretStr(token)
    earlier: list[Call] = await _result(desk.open.remote(str(folder.path.resolve()), config, options, secret))
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
    spending, gate = Spending(options.limits, options.prices), AdaptiveGate(options.concurrency)
    for call in earlier:
        spending.add(call)
    flights: list[Flight] = []
    fatal: str | None = None

    async def tell() -> None:
        nonlocal fatal
        calls, waits, gate.active, fatal = await _result(desk.news.remote())
        for call in calls:
            spending.add(call)
            observer.called(call)
        for seconds, reason in waits:
            observer.waiting(seconds, reason)

    async def keep_telling() -> None:
        while True:
            await tell()
            await asyncio.sleep(NEWS_SECONDS)

    async def fly_one(index: int) -> bool:
        flight: Flight | None = await _result(
            flyers[index % len(flyers)].fly.remote(this_driver(), desk, config, options, index)
        )
        # A flight that the limits did not let begin is not one.
        if flight is not None and (flight.begun or flight.status != "budget_stop"):
            flights.append(flight)
            observer.flown(flight)
        return flight is not None and fatal is None

    observer.started(config, spending, gate)
    telling = asyncio.ensure_future(keep_telling())
    try:
        await do_all(config.flights, options.concurrency, fly_one)
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
        # Also when interrupted: what was flown is then there to be seen.
        folder.write_flights(flights, config.model)
    return result_of(config, flights, fatal)


def _actor(kind: type, options: Options, **settings: Any) -> Any:
    # All flights may ask at once, and the driver besides.
    remote: Any = cast(Any, ray).remote(max_concurrency=4 * options.concurrency + 100, **settings)(kind)
    return remote.remote()


async def _result(reference: Awaitable[Any]) -> Any:
    """What a call brings, or raises."""
    try:
        return await reference
    except RayTaskError as error:
        cause: Any = error.cause
        if isinstance(cause, (DroneEnvError, OSError)):
            raise cause from None
        raise ClusterError(f"a node failed: {error}") from None
    except RayError as error:
        raise ClusterError(f"a part of the run was lost: {error}") from None
