"""A run: many flights at once, each call in the transcript before it counts."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from drone_env.core.actions import Action
from drone_env.llm.answers import TURN_KINDS, TurnKind, Unusable
from drone_env.llm.caller import Caller
from drone_env.llm.config import RunConfig
from drone_env.llm.desk import Desk, Watcher
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.gate import Gate, StoppedError
from drone_env.llm.pilot import PilotedEpisode, fly_one
from drone_env.llm.run_folder import TRANSCRIPT, PilotedRecord, RunFolder, results_of
from drone_env.llm.transcript import Transcript
from drone_env.results.log_lines import end_line, start_line, step_line
from drone_env.results.statistics import Summary

Verdict = Literal["valid", "incomplete", "invalid", "stopped"]
MOST_ERRORED = 0.05
EXIT_STATUS: dict[Verdict, int] = {"valid": 0, "invalid": 1, "stopped": 2, "incomplete": 3}


class Observer(Watcher, Protocol):
    """Hears what happens in a run."""

    def flown(self, flown: PilotedEpisode) -> None:
        """A flight is over."""
        ...


@dataclass(frozen=True)
class RunResult:
    """The result of a run.

    Attributes:
        config: The run.
        verdict: `valid`; `stopped` by an endpoint that refuses; `invalid` because too many flights errored;
            `incomplete` because a limit was reached.
        reason: Why it is not valid, in words.
        flights: All that were begun and not left in the middle, in order.
    """

    config: RunConfig
    verdict: Verdict
    reason: str
    flights: list[PilotedEpisode]


Engine = Callable[[RunConfig, RunFolder, str | None, Gate, Observer], Coroutine[Any, Any, RunResult]]
"""What flies a run: `run`, or the same on a cluster."""


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


async def run(config: RunConfig, folder: RunFolder, token: str | None, gate: Gate, observer: Observer) -> RunResult:
    """Fly all flights of a run, going on where its transcript ends. The folder then holds records and results.

    Args:
        config: The run.
        folder: Its folder.
        token: What authorises; None to send none.
        gate: What its requests pass, which is new.
        observer: Hears what happens.

    Raises:
        OSError: if the folder cannot be written to.
        InvalidValueError: if the transcript is damaged or of another run.
    """
    options = gate.options
    with contextlib.closing(Transcript(folder.path / TRANSCRIPT)) as transcript:
        desk = Desk(config, transcript, gate, observer)
        endpoint = Endpoint(config, token, options.timeout)
        caller = Caller(config, endpoint, desk, options, gate.clock)
        try:
            flights = await fly_all(
                config, folder, gate, observer, lambda index: fly_one(config, index, caller.ask, options.server)
            )
        finally:
            await endpoint.close()
    return result_of(config, flights, gate)


async def fly_all(
    config: RunConfig,
    folder: RunFolder,
    gate: Gate,
    observer: Observer,
    fly: Callable[[int], Awaitable[PilotedEpisode]],
) -> list[PilotedEpisode]:
    """Fly all flights, as many at once as there may be requests, until one fails or is stopped; write what was flown.

    Args:
        config: The run.
        folder: Its folder.
        gate: What its requests pass, or a copy of that.
        observer: Hears what happens.
        fly: Flies the flight of a number; raises `StoppedError` where the run is being stopped.
    """
    flights: list[PilotedEpisode] = []
    numbers = iter(range(config.flights))

    async def worker() -> None:
        for number in numbers:
            flown = await fly(number)
            # A flight that the limits did not let begin is not one.
            if flown.begun or flown.status != "budget_stop":
                flights.append(flown)
                observer.flown(flown)
            gate.check_going_on()

    workers = [asyncio.ensure_future(worker()) for _ in range(min(config.flights, gate.options.concurrency))]
    try:
        with contextlib.suppress(StoppedError):
            await asyncio.gather(*workers)
    finally:
        for task in workers:
            task.cancel()
        await asyncio.gather(*workers, return_exceptions=True)
        # Also when interrupted: what was flown is then there to be seen.
        folder.write_flights(flights, config.model)
    return flights


def result_of(config: RunConfig, flights: list[PilotedEpisode], gate: Gate) -> RunResult:
    """The result of a run from its flights, in any order."""
    ordered = sorted(flights, key=lambda flown: flown.index)
    fatal = None if gate.fatal is None else str(gate.fatal)
    verdict, reason = verdict_of(config.flights, [flown.status for flown in ordered], fatal)
    return RunResult(config, verdict, reason, ordered)


def log_text(flown: PilotedEpisode, model: str) -> str:
    """The log lines of a flight, each with its newline.

    The steps of an unusable answer name it as their error. A flight that stopped early has fewer steps, and its score
    is what waiting to the end would earn.
    """
    episode = flown.episode
    lines = [start_line(episode.task, model)]
    for number, (step, error) in enumerate(zip(episode.path, flown.step_errors, strict=True), 1):
        done = episode.ended and number == episode.steps
        lines.append(step_line(number, Action(step.action), step.reward, done, error))
    lines.append(end_line(episode.success, episode.counted_score(), episode.rewards))
    return "".join(f"{line}\n" for line in lines)


def summary_lines(result: RunResult) -> list[str]:
    """The result of a run, for people: the score of those that count, how the answers came out, and the verdict."""
    counted = [flight for flight in result.flights if flight.status != "errored"]
    outcomes: dict[TurnKind, int] = {
        name: sum(flight.turns.count(name) for flight in result.flights) for name in TURN_KINDS
    }
    waits = sum(error is not None for flight in result.flights for error in flight.step_errors)
    errored = len(result.flights) - len(counted)
    unfinished = sum(not flight.episode.ended for flight in counted)
    lines, unusable = list[str](), Unusable.among(outcomes)
    mean = Summary.of(results_of(result.config, [PilotedRecord.of(flight) for flight in result.flights], {})).score
    if mean is not None:
        success = sum(flight.episode.success for flight in counted)
        flights = f"{len(counted)} flights, {success} delivered everything"
        lines.append(f"mean score {mean:.4f} over {flights}; unusable answers: {unusable}")
    lines.append(f"errored and left out: {errored}; unfinished, counted as waiting to the end: {unfinished}")
    lines.append(f"answers: {', '.join(f'{name} {count}' for name, count in outcomes.items())}; WAIT in place: {waits}")
    if outcomes["truncated"]:
        lines.append("truncated answers: a larger --max-answer-tokens leaves room for thoughts")
    verdict = result.verdict.upper() if result.verdict == "invalid" else result.verdict
    reason = f"{': ' if result.reason else ''}{result.reason}"
    lines.append(f"verdict: {verdict}{reason}{'; ' if unusable.marked else ''}{unusable.mark}")
    return lines
