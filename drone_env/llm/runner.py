"""A run: many flights at once, each call in the transcript before it counts."""

import asyncio
import contextlib
import math
from collections import defaultdict
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol
from urllib.parse import urlsplit

from drone_env.core.actions import Action
from drone_env.episodes.log_lines import end_line, start_line, step_line
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import OUTCOMES
from drone_env.llm.cache import AnswerCache
from drone_env.llm.caller import Caller, RetryPolicy
from drone_env.llm.clock import Clock
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.config import RunConfig
from drone_env.llm.desk import LocalDesk, StoppedError, Watcher
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.image import ServerFlight
from drone_env.llm.limits import Limits, Prices, Spending
from drone_env.llm.pace import Pace
from drone_env.llm.pilot import Flight, fly, mission_of
from drone_env.llm.run_folder import TRANSCRIPT, RunFolder
from drone_env.llm.transcript import Transcript

Verdict = Literal["valid", "incomplete", "invalid", "stopped"]
MOST_ERRORED = 0.05
EXIT_STATUS: dict[Verdict, int] = {"valid": 0, "invalid": 1, "stopped": 2, "incomplete": 3}


@dataclass(frozen=True)
class Options:
    """How a run is made; none of this changes its results.

    Attributes:
        concurrency: The most requests, and flights, at once.
        timeout: Seconds that an answer may take.
        limits: What may be spent.
        prices: What tokens cost, if that is known.
        retries: How often a call is tried.
        cache: Folder of answers to share between runs.
        server: Address of a server that flies along.
        requests_per_minute, tokens_per_minute: What the endpoint is sent at most; None for no limit.
    """

    concurrency: int = 64
    timeout: float = 120.0
    limits: Limits = field(default_factory=Limits)
    prices: Prices | None = None
    retries: RetryPolicy = field(default_factory=RetryPolicy)
    cache: Path | None = None
    server: str | None = None
    requests_per_minute: float | None = None
    tokens_per_minute: float | None = None

    def __post_init__(self) -> None:
        Pace(self.requests_per_minute, self.tokens_per_minute)
        if not 1 <= self.concurrency <= 10_000:
            raise InvalidValueError(f"--concurrency must be 1 to 10000, got {self.concurrency}")
        if not 0 < self.timeout < float("inf"):
            raise InvalidValueError(f"--timeout must be above 0 s, got {self.timeout}")
        if self.limits.cost is not None and self.prices is None:
            raise InvalidValueError("--max-cost needs prices: give --price-prompt and --price-completion")


class Observer(Watcher, Protocol):
    """Is told what happens in a run."""

    def started(self, config: RunConfig, spending: Spending, gate: AdaptiveGate) -> None:
        """It begins."""
        ...

    def flown(self, flight: Flight) -> None:
        """A flight is over."""
        ...


@dataclass(frozen=True)
class RunResult:
    """What came of a run.

    Attributes:
        verdict: `valid`; `stopped` by an endpoint that refuses; `invalid` because too many flights errored;
            `incomplete` because a limit was reached.
        reason: Why it is not valid, in words.
        flights: All that were begun and not left in the middle, in order.
    """

    verdict: Verdict
    reason: str
    flights: list[Flight]


Run = Callable[[RunConfig, RunFolder, str | None, Options, Observer], Coroutine[Any, Any, RunResult]]
"""How a run is flown: `run`, or the same on a cluster."""


def verdict_of(flights: int, statuses: list[str], fatal: str | None = None) -> tuple[Verdict, str]:
    """What a run is worth, and why.

    Args:
        flights: How many it should have.
        statuses: Of those that were flown.
        fatal: Why the endpoint refused every call, if it did.
    """
    errored = statuses.count("errored")
    if fatal is not None:
        return "stopped", fatal
    if statuses and errored / len(statuses) > MOST_ERRORED:
        return "invalid", f"{errored} of {len(statuses)} flights errored, more than {MOST_ERRORED:.0%}"
    if "budget_stop" in statuses or len(statuses) < flights:
        left = flights - len(statuses)
        return "incomplete", f"{statuses.count('budget_stop')} flights were cut short and {left} not begun"
    return "valid", ""


async def run(
    config: RunConfig,
    folder: RunFolder,
    token: str | None,
    options: Options,
    observer: Observer,
    clock: Clock | None = None,
) -> RunResult:
    """Fly all flights of a run, going on where its transcript ends. The folder then holds records and results.

    Raises:
        OSError: if the folder cannot be written to.
        InvalidValueError: if the transcript is damaged or of another run.
    """
    prompt, clock = config.load_prompt(), clock or Clock()
    flights: list[Flight] = []
    spending = Spending(options.limits, options.prices, clock=clock)
    gate = AdaptiveGate(options.concurrency, clock)
    with contextlib.ExitStack() as stack:
        transcript = Transcript(folder.path / TRANSCRIPT, token)
        stack.callback(transcript.close)
        # Also when interrupted: what was flown is then there to be seen.
        stack.callback(lambda: folder.write_flights(flights, config.model))
        desk = open_desk(config, transcript, spending, gate, options, observer, clock)
        endpoint = Endpoint(config, token, prompt.plan, options.timeout)
        caller = Caller(config, prompt.plan, endpoint, desk, options.retries, clock)
        observer.started(config, spending, gate)

        async def fly_one(index: int) -> bool:
            """Whether to go on with the next one."""
            server = None if options.server is None else ServerFlight(options.server)
            try:
                flight = await fly(mission_of(config, index), prompt, caller.ask, server)
            except StoppedError:
                return False
            finally:
                if server is not None:
                    server.close()
            # A flight that the limits did not let begin is not one.
            if flight.begun or flight.status != "budget_stop":
                flights.append(flight)
                observer.flown(flight)
            return desk.fatal is None

        try:
            await do_all(config.flights, options.concurrency, fly_one)
        finally:
            await endpoint.close()
    return result_of(config, flights, None if desk.fatal is None else str(desk.fatal))


def open_desk(
    config: RunConfig,
    transcript: Transcript,
    spending: Spending,
    gate: AdaptiveGate,
    options: Options,
    watcher: Watcher,
    clock: Clock | None = None,
) -> LocalDesk:
    """The desk of a run, inside of a running event loop."""
    cache = None if options.cache is None else AnswerCache(options.cache)
    pace = Pace(options.requests_per_minute, options.tokens_per_minute, clock)
    return LocalDesk(urlsplit(config.base_url).netloc, transcript, spending, gate, pace, cache, watcher, clock)


def result_of(config: RunConfig, flights: list[Flight], fatal: str | None) -> RunResult:
    """The result of a run from its flights, in any order."""
    ordered = sorted(flights, key=lambda flight: flight.index)
    verdict, reason = verdict_of(config.flights, [flight.status for flight in ordered], fatal)
    return RunResult(verdict, reason, ordered)


async def do_all(n: int, at_once: int, work: Callable[[int], Coroutine[Any, Any, bool]]) -> None:
    """Do `work(0)` to `work(n - 1)`, so many at once, until one says to stop or fails."""
    numbers = iter(range(n))
    stop = asyncio.Event()

    async def worker() -> None:
        for number in numbers:
            if not await work(number):
                stop.set()
                return

    tasks = [asyncio.ensure_future(worker()) for _ in range(min(n, at_once))]
    stopping = asyncio.ensure_future(stop.wait())
    waiting: set[asyncio.Future[Any]] = {stopping, *tasks}
    try:
        while not stop.is_set() and any(not task.done() for task in tasks):
            done, waiting = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
    finally:
        for task in (stopping, *tasks):
            task.cancel()
        await asyncio.gather(stopping, *tasks, return_exceptions=True)


def log_text(flight: Flight, model: str) -> str:
    """The log lines of a flight, each with its newline.

    The steps of an unusable answer name it as their error. A flight that stopped early has fewer steps, and its score
    is what waiting to the end would earn.
    """
    episode = flight.episode
    lines = [start_line(episode.task, model)]
    for number, (step, error) in enumerate(zip(episode.path, flight.step_errors, strict=True), 1):
        done = episode.ended and number == episode.steps
        lines.append(step_line(number, Action(step.action), step.reward, done, error))
    lines.append(end_line(episode.success, episode.counted_score(), episode.rewards))
    return "".join(f"{line}\n" for line in lines)


def mean_over_maps(values: Sequence[tuple[int, float]]) -> float | None:
    """The mean over the maps of (map, value) pairs, those of one map averaged first; None where there are none."""
    by_map: dict[int, list[float]] = defaultdict(list)
    for seed, value in values:
        by_map[seed].append(value)
    return math.fsum(math.fsum(of_map) / len(of_map) for of_map in by_map.values()) / len(by_map) if by_map else None


def summary_lines(result: RunResult) -> list[str]:
    """What came of a run, for people: the verdict, the score of those that count, and how the answers came out."""
    counted = [flight for flight in result.flights if flight.status != "errored"]
    outcomes = {name: sum(flight.turns.count(name) for flight in result.flights) for name in OUTCOMES}
    waits = sum(error is not None for flight in result.flights for error in flight.step_errors)
    errored = len(result.flights) - len(counted)
    unfinished = sum(not flight.episode.ended for flight in counted)
    lines: list[str] = []
    mean = mean_over_maps([(flight.seed, flight.episode.counted_score()) for flight in counted])
    if mean is not None:
        success = sum(flight.episode.success for flight in counted)
        lines.append(f"mean score {mean:.4f} over {len(counted)} flights, {success} delivered everything")
    lines.append(f"errored and left out: {errored}; unfinished, counted as waiting to the end: {unfinished}")
    lines.append(f"answers: {', '.join(f'{name} {count}' for name, count in outcomes.items())}; WAIT in place: {waits}")
    verdict = result.verdict.upper() if result.verdict == "invalid" else result.verdict
    lines.append(f"verdict: {verdict}{': ' if result.reason else ''}{result.reason}")
    return lines
