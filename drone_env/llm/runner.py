"""A run: many flights at once. Each call is in the transcript before its answer is used."""

import asyncio
import contextlib
import random
import time
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from drone_env.errors import EndpointError
from drone_env.llm.answers import Answer, Reading, Unusable, in_common
from drone_env.llm.budget import Budget, LimitReachedError
from drone_env.llm.config import RunConfig
from drone_env.llm.on_server import repeat_on_server
from drone_env.llm.progress import Progress
from drone_env.llm.rejections import Changes, described
from drone_env.llm.run_folder import TRANSCRIPT, Run, Verdict, turns_of, write_records
from drone_env.llm.sender import Sender, TryFailedError
from drone_env.llm.text_episode import EpisodeRun
from drone_env.llm.transcript import Call, Failure, Transcript, answered_calls, digest
from drone_env.results.statistics import Summary
from drone_env.results.tables import plural

EXIT_STATUS: dict[Verdict, int] = {"valid": 0, "invalid": 1, "stopped": 2, "incomplete": 3}
OVERLOADED = {429, 503, 529}
MAX_BACKOFF = 30.0
MAX_WAIT = 120.0
"""A call fails if the endpoint requests a longer wait in seconds (`Retry-After`)."""


@dataclass
class Calls:
    """Makes the calls of a run, with retries.

    Attributes:
        config: The run.
        sender: Sends the requests.
        transcript: Gets every call.
        budget: Decides when a request is sent.
        progress: Shows the progress.
        fatal: Why every further request would fail; None if there is no such reason.
        changes: What requests change because the endpoint rejected it.
    """

    config: RunConfig
    sender: Sender
    transcript: Transcript
    budget: Budget
    progress: Progress
    fatal: str | None = None
    changes: Changes = field(init=False)

    def __post_init__(self) -> None:
        self.changes = {name: new for call in self.transcript.calls for name, new in call.changes.items()}

    async def fly_turn(self, run: EpisodeRun) -> None:
        """Make the next call of a flight and fly its answer; stop the flight if there is none."""
        failures, answer, reading, latency = list[Failure](), None, None, 0.0
        try:
            answer, reading, latency = await self._send(run, failures)
            outcome = reading.kind
        except LimitReachedError as error:
            run.stop(outcome := "budget_stop", str(error))
            if not failures:
                return
        except TryFailedError as failed:
            # If the very first call fails, such as for a rejected parameter or by a redirect, all others would.
            if failed.fatal or not self.budget.answers:
                verb = "returned" if failed.status else "gives"
                self.fatal = f"{urlsplit(self.config.base_url).netloc} {verb} {failed}"
            run.stop("errored", str(failed))
            outcome = "api_error"
        call = Call(
            **run.key._asdict(),
            messages=run.body["messages"],
            request_digest=digest(run.body),
            changes=dict(run.changes),
            answer=answer,
            outcome=outcome,
            failures=failures,
            latency=latency,
            at=time.time(),
        )
        self.transcript.append(call)
        self.budget.count(call)
        if reading is not None:
            run.take(reading)
            self.progress.on_steps(run)

    async def _send(self, run: EpisodeRun, failures: list[Failure]) -> tuple[Answer, Reading, float]:
        """The answer, and its seconds without any wait for a turn; appends each failed try to `failures`."""
        options = self.budget.options
        while True:
            await self.budget.turn()
            sent = time.monotonic()
            try:
                answer = await self.sender.send(run.request(self.changes), str(run.key))
                latency = time.monotonic() - sent
                return answer, run.read(answer), latency
            except TryFailedError as error:
                failed = error
            if failed.changes:
                # Each part is rejected once at most, so this ends, also without tries left.
                if failed.changes.items() - self.changes.items():
                    self.changes = {**self.changes, **failed.changes}
                    self.progress.notice(f"{described(failed.changes)}: the endpoint returned {failed}")
                failures.append(Failure(status=failed.status, reason=failed.reason, waited=0.0))
                continue
            wait = random.uniform(0, min(MAX_BACKOFF, options.backoff * 2 ** min(len(failures), 30)))
            wait = wait if failed.retry_after is None else failed.retry_after
            again = failed.retried and len(failures) + 1 < options.tries and wait <= MAX_WAIT
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=wait if again else 0.0))
            if not again:
                raise failed
            if failed.status in OVERLOADED:
                self.budget.pause(wait)
            attempt = f"map {run.seed}, turn {run.key.turn}: attempt {len(failures)} of {options.tries} failed"
            self.progress.on_wait(f"{attempt}: {failed}; next attempt in {wait:.1f} s")
            await asyncio.sleep(wait)


async def run_flights(config: RunConfig, folder: Path, sender: Sender, progress: Progress) -> Run:
    """Fly all flights of a run, continuing its transcript. The folder then contains records.

    Args:
        config: The run.
        folder: Its folder, which is locked.
        sender: Sends the requests; it is closed.
        progress: Shows the progress, and contains the options.
    """
    flights, fatal, budget = list[EpisodeRun](), None, progress.budget
    prompt, numbers, options = config.load_prompt(), iter(range(config.flights)), progress.budget.options
    with contextlib.closing(Transcript(folder / TRANSCRIPT)) as transcript:
        budget.resume(transcript.calls)
        answered = answered_calls(transcript.calls)
        calls = Calls(config, sender, transcript, budget, progress)

        async def worker() -> None:
            for number in numbers:
                run = config.episode_run(number, prompt)
                if run.replay(answered.get(number, {})):
                    progress.on_steps(run)
                while run.messages:
                    await calls.fly_turn(run)
                if options.server is not None:
                    await asyncio.to_thread(repeat_on_server, options.server, run.episode, config.model)
                if run.begun:
                    flights.append(run)
                    progress.on_flight(run)
                if calls.fatal is not None:
                    raise EndpointError(calls.fatal)

        workers = [asyncio.ensure_future(worker()) for _ in range(min(options.concurrency, config.flights))]
        try:
            await asyncio.gather(*workers)
        except EndpointError as error:
            fatal = str(error)
        finally:
            for task in workers:
                task.cancel()
            await asyncio.gather(*workers, return_exceptions=True)
            await sender.close()
            # Also after an interruption.
            run = Run(folder, config, sorted(flights, key=lambda run: run.index), budget, fatal)
            write_records(run)
    return run


def summary_lines(run: Run) -> list[str]:
    """The result of a run as text: the score of the flights that count, and the verdict."""
    unusable, lines, (verdict, reason) = Unusable.among(turns_of(run.flights)), list[str](), run.verdict
    mean = Summary.of(run.results()).score
    if mean is not None:
        counted = run.counted
        flights = f"{plural(len(counted), 'flight')}, {sum(one.success for one in counted)} delivered everything"
        decisions, steps = Unusable.among(turns_of(counted)).of, sum(one.episode.steps for one in counted)
        flights += f" by {plural(decisions, 'decision')} in {plural(steps, 'step')}"
        lines.append(f"mean score {mean:.4f} over {flights}; unusable answers: {unusable}")
    if unusable.marked:
        lines.append(in_common([fault for flight in run.flights for fault in flight.faults]))
    told = ": ".join(filter(None, (verdict.upper() if verdict == "invalid" else verdict, reason)))
    return [*lines, "; ".join(filter(None, (f"verdict: {told}", unusable.mark)))]
