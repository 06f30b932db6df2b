"""A run: many flights at once, whose calls are in the transcript before their answers are used."""

import asyncio
import contextlib
import functools
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn, Protocol
from urllib.parse import urlsplit

from drone_env.core.actions import Action
from drone_env.errors import EndpointError
from drone_env.files import write_text
from drone_env.llm.answers import TURN_KINDS, Answer, Reading, TurnKind, Unusable
from drone_env.llm.config import RunConfig, request_bodies
from drone_env.llm.content import ChatMessage, with_pictures
from drone_env.llm.endpoint import TryFailedError
from drone_env.llm.flight import CallFailedError, PilotedEpisode, fly
from drone_env.llm.image import following
from drone_env.llm.limiter import LimitReachedError, RateLimiter, StoppedError
from drone_env.llm.run_folder import TRANSCRIPT, PilotedRecord, RunFolder, results_of
from drone_env.llm.transcript import Call, CallKey, Failure, Transcript, cached_answer, digest
from drone_env.results.log_lines import end_line, start_line, step_line
from drone_env.results.statistics import Summary

Verdict = Literal["valid", "incomplete", "invalid", "stopped"]
MOST_ERRORED = 0.05
EXIT_STATUS: dict[Verdict, int] = {"valid": 0, "invalid": 1, "stopped": 2, "incomplete": 3}
LONGEST_BACKOFF = 30.0
LONGEST_WAIT = 120.0
"""A call whose endpoint asks for a longer wait in seconds (`Retry-After`) has failed."""


class Sender(Protocol):
    """An `Endpoint`, of this process or of others."""

    async def send(self, messages: Sequence[ChatMessage], call_id: str, repeat: int) -> Answer:
        """See `Endpoint.send`."""
        ...

    async def close(self) -> None:
        """Close all connections."""


class Observer:
    """Is called when something happens in a run; this one does nothing."""

    def called(self, call: Call) -> None:
        """A call was made."""

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed; the next one comes after this many seconds."""

    def flown(self, flown: PilotedEpisode) -> None:
        """A flight is over."""


@dataclass(frozen=True)
class RunResult:
    """The result of a run.

    Attributes:
        config: The run.
        verdict: `valid`; `stopped` by an endpoint that refuses; `invalid` because too many flights errored;
            `incomplete` because a limit was reached.
        reason: Why it is not valid, in words.
        flights: All that began and were not abandoned, in order.
    """

    config: RunConfig
    verdict: Verdict
    reason: str
    flights: list[PilotedEpisode]


def verdict_of(flights: int, statuses: list[str], fatal: str | None = None) -> tuple[Verdict, str]:
    """The verdict on a run, and its reason.

    Args:
        flights: How many it should have.
        statuses: Those of its flights.
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


class Calls:
    """Makes the calls of a run: each answer comes from the transcript, the cache, or the endpoint with retries.

    Args:
        config: The run.
        endpoint: Sends the requests.
        transcript: Gets every call.
        limiter: Decides when a request is sent.
        observer: Is called when something happens.
    """

    def __init__(
        self, config: RunConfig, endpoint: Sender, transcript: Transcript, limiter: RateLimiter, observer: Observer
    ) -> None:
        self._url = config.base_url
        self._prompt = config.load_prompt()
        self._bodies = request_bodies(config)
        self._endpoint = endpoint
        self._transcript = transcript
        self._limiter = limiter
        self._observer = observer
        self._cache = limiter.options.cache
        if self._cache is not None:
            self._cache.mkdir(parents=True, exist_ok=True)

    async def ask(self, seed: int, repeat: int, key: CallKey, messages: list[ChatMessage]) -> Reading:
        """The answer to a call of the flight over this map, as it is understood.

        Raises:
            CallFailedError: if none came after all retries.
            LimitReachedError: if the budget of the run is spent.
            StoppedError: if the run is being stopped because of another call.
            InvalidValueError: if the transcript contains another request under this key.
        """
        body = self._bodies[repeat]
        request = digest({"body": body, "messages": messages})
        known = self._transcript.answered.get(key)
        if known is not None and known.answer is not None:
            known.require_same(messages, request, body.get("seed"))
            return self._prompt.read_answer(known.answer)
        self._limiter.check_going_on()
        # Repeats and repairs draw again from the model: only equal ones share an answer.
        name = digest([self._url, request, repeat, key.attempt])
        cache = None if self._cache is None else self._cache / f"{name}.json"
        answer = None if cache is None else cached_answer(cache)
        cached, picture, began = answer is not None, None, self._limiter.clock.now()
        failures: list[Failure] = []

        def record(answer: Answer | None, outcome: str) -> None:
            call = Call(
                flight=key.flight,
                seed=seed,
                repeat=repeat,
                turn=key.turn,
                attempt=1 if key.attempt == 1 else 2,
                messages=messages,
                picture=picture,
                request_digest=request,
                sampling_seed=body.get("seed"),
                answer=answer,
                outcome=outcome,
                failures=failures,
                latency=0.0 if cached else self._limiter.clock.now() - began,
                at=time.time(),
                cached=cached,
            )
            self._limiter.count(call)
            self._transcript.append(call)
            self._observer.called(call)

        if answer is None:
            sent, picture = with_pictures(messages)
            try:
                answer, began = await self._send(seed, repeat, key, sent, failures)
            except LimitReachedError:
                if failures:
                    record(None, "budget_stop")
                raise
            except TryFailedError as failed:
                record(None, "api_error")
                self._give_up(failed)
        reading = self._prompt.read_answer(answer)
        record(answer, reading.kind)
        if cache is not None and not cached:
            write_text(cache, answer.model_dump_json())
        return reading

    async def _send(
        self, seed: int, repeat: int, key: CallKey, messages: list[ChatMessage], failures: list[Failure]
    ) -> tuple[Answer, float]:
        """The answer and when its request was sent; it appends every failed try to `failures`."""
        limiter, options = self._limiter, self._limiter.options
        while True:
            async with limiter.slot() as sent_at:
                try:
                    answer = await self._endpoint.send(messages, str(key), repeat)
                except TryFailedError as error:
                    failed, asked = error, error.retry_after
                    if failed.retried:
                        limiter.overloaded(sent_at, min(asked or 0.0, LONGEST_WAIT))
                else:
                    limiter.answered()
                    return answer, sent_at
            again = failed.retried and len(failures) + 1 < options.tries and (asked or 0.0) <= LONGEST_WAIT
            bound = min(LONGEST_BACKOFF, options.backoff * 2 ** len(failures))
            wait = (random.uniform(0, bound) if asked is None else asked) if again else 0.0
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=wait))
            if not again:
                raise failed
            attempt = f"attempt {len(failures)} of {options.tries} failed"
            self._observer.waiting(wait, f"map {seed}, turn {key.turn}: {attempt}: {failed}")
            await limiter.clock.sleep(wait)

    def _give_up(self, failed: TryFailedError) -> NoReturn:
        self._limiter.check_going_on()
        # Every call would meet what the very first one meets, such as a rejected parameter, or a redirect.
        first = not self._transcript.answered and 300 <= failed.status < 500 and not failed.retried
        if failed.fatal or first:
            host = urlsplit(self._url).netloc
            self._limiter.fatal = EndpointError(f"{host} answers {failed.status}: {failed.reason}")
        raise CallFailedError(str(failed))


async def run(
    config: RunConfig, folder: RunFolder, endpoint: Sender, limiter: RateLimiter, observer: Observer
) -> RunResult:
    """Fly all flights of a run from the end of its transcript. The folder then contains records and results.

    Args:
        config: The run.
        folder: Its folder.
        endpoint: Sends the requests; it is closed.
        limiter: Decides when a request is sent; it must be new.
        observer: Is called when something happens.

    Raises:
        OSError: if the folder cannot be written to.
        InvalidValueError: if the transcript is damaged or belongs to another run.
    """
    flights: list[PilotedEpisode] = []
    prompt, numbers = config.load_prompt(), iter(range(config.flights))
    with contextlib.closing(Transcript(folder.path / TRANSCRIPT)) as transcript:
        for call in transcript.calls:
            limiter.requests += call.requests
            limiter.count(call)
        calls = Calls(config, endpoint, transcript, limiter, observer)

        async def worker() -> None:
            for number in numbers:
                flown = PilotedEpisode.begin(config, number)
                ask = functools.partial(calls.ask, flown.episode.seed, flown.repeat)
                with following(limiter.options.server, config.model) as on_step:
                    await fly(flown, prompt, config.history, ask, on_step)
                # A flight without an answer because of the limits has not begun.
                if flown.begun or flown.status != "budget_stop":
                    flights.append(flown)
                    observer.flown(flown)
                limiter.check_going_on()

        workers = [asyncio.ensure_future(worker()) for _ in range(min(config.flights, limiter.options.concurrency))]
        try:
            with contextlib.suppress(StoppedError):
                await asyncio.gather(*workers)
        finally:
            for task in workers:
                task.cancel()
            await asyncio.gather(*workers, return_exceptions=True)
            await endpoint.close()
            # Also after an interruption.
            flights.sort(key=lambda flown: flown.index)
            folder.write_flights(flights)
    fatal = None if limiter.fatal is None else str(limiter.fatal)
    return RunResult(config, *verdict_of(config.flights, [flown.status for flown in flights], fatal), flights)


def log_text(flown: PilotedEpisode, model: str) -> str:
    """The log lines of a flight, each with its newline.

    The steps of an unusable answer name it as their error. A flight that stopped early has fewer steps, and its score
    is that of waiting to the end.
    """
    episode = flown.episode
    lines = [start_line(episode.task, model)]
    for number, (step, error) in enumerate(zip(episode.path, flown.step_errors, strict=True), 1):
        done = episode.ended and number == episode.steps
        lines.append(step_line(number, Action(step.action), step.reward, done, error))
    lines.append(end_line(episode.success, episode.counted_score(), episode.rewards))
    return "".join(f"{line}\n" for line in lines)


def summary_lines(result: RunResult) -> list[str]:
    """The result of a run, for people: the score of the flights that count, the outcomes of answers, the verdict."""
    records = [PilotedRecord.of(flight) for flight in result.flights]
    counted = [record for record in records if record.status != "errored"]
    turns: dict[TurnKind, int] = {name: sum(record.turns[name] for record in records) for name in TURN_KINDS}
    unusable, lines = Unusable.among(turns), list[str]()
    mean = Summary.of(results_of(result.config, records, {})).score
    if mean is not None:
        success = sum(record.success for record in counted)
        flights = f"{len(counted)} flights, {success} delivered everything"
        lines.append(f"mean score {mean:.4f} over {flights}; unusable answers: {unusable}")
    unfinished = sum(not record.ended for record in counted)
    waits = sum(record.waits for record in records)
    lines += [
        f"errored and left out: {len(records) - len(counted)}; unfinished, counted as waiting to the end: {unfinished}",
        f"answers: {', '.join(f'{name} {count}' for name, count in turns.items())}; WAIT in place: {waits}",
    ]
    verdict = result.verdict.upper() if result.verdict == "invalid" else result.verdict
    said = ": ".join(filter(None, (verdict, result.reason)))
    return [*lines, "; ".join(filter(None, (f"verdict: {said}", unusable.mark)))]
