"""A run: many flights at once. Each call is in the transcript before its answer is used."""

import asyncio
import contextlib
import random
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

from drone_env.errors import EndpointError, StoreError
from drone_env.flights.store import Store
from drone_env.llm.answers import Answer, Reading, Unusable, in_common
from drone_env.llm.budget import Budget, LimitReachedError
from drone_env.llm.config import RunConfig
from drone_env.llm.on_server import repeat_on_server
from drone_env.llm.run_folder import TRANSCRIPT, EpisodeIds, Run, Verdict, turns_of, write_records
from drone_env.llm.sender import Changes, Sender, TryFailedError, described
from drone_env.llm.text_episode import EpisodeRun
from drone_env.llm.transcript import Call, Failure, Transcript, answered_calls, digest
from drone_env.results.statistics import Summary
from drone_env.results.tables import plural

EXIT_STATUS: dict[Verdict, int] = {"valid": 0, "invalid": 1, "stopped": 2, "incomplete": 3}
OVERLOADED = {429, 503, 529}
MAX_BACKOFF = 30.0
MAX_WAIT = 120.0
"""A call fails if the endpoint requests a longer wait in seconds (`Retry-After`)."""
LINE_SECONDS, QUIET_SECONDS = 10.0, 1.0
"""Seconds between two lines of progress, and between two lines about waits."""


class Runner:
    """Flies a run. Standard output gets the log lines of each flight, standard error everything else.

    The lines of a flight stay together. Of flights one at a time, each line is printed as it happens.

    Args:
        config: The run.
        folder: Its folder, which is locked.
        sender: Sends the requests; it is closed at the end.
        budget: Decides when a request is sent.
        store: Gets each finished episode, once however often the run is resumed; None to store none.
    """

    def __init__(
        self, config: RunConfig, folder: Path, sender: Sender, budget: Budget, store: Store | None = None
    ) -> None:
        self.config, self.folder, self.sender, self.budget, self.store = config, folder, sender, budget, store
        self._flights: list[EpisodeRun] = []
        self._transcript = Transcript(folder / TRANSCRIPT)
        self._changes: Changes = {name: new for call in self._transcript.calls for name, new in call.changes.items()}
        """What requests change because the endpoint rejected it."""
        self._fatal: str | None = None
        """Why every further request would fail; None if there is no such reason."""
        self._at_once = min(budget.options.concurrency, config.flights)
        self._printed = 0
        """Log lines of the flight that is printed as it happens."""
        self._line_shown, self._wait_shown = time.monotonic(), 0.0

    async def fly(self) -> Run:
        """Fly all flights, continuing the transcript. The folder then contains records."""
        config, budget, prompt, fatal = self.config, self.budget, self.config.load_prompt(), None
        with contextlib.closing(self._transcript) as transcript:
            budget.resume(transcript.calls)
            answered, numbers = answered_calls(transcript.calls), iter(range(config.flights))

            async def worker() -> None:
                for number in numbers:
                    run = config.episode_run(number, prompt)
                    run.replay(answered.get(number, {}))
                    self._show(run)
                    while run.messages:
                        await self._fly_turn(run)
                    if budget.options.server is not None:
                        await asyncio.to_thread(repeat_on_server, budget.options.server, run.episode, config.model)
                    if run.begun:
                        self._end(run)
                    if self._fatal is not None:
                        raise EndpointError(self._fatal)

            workers = [asyncio.ensure_future(worker()) for _ in range(self._at_once)]
            try:
                await asyncio.gather(*workers)
            except EndpointError as error:
                fatal = str(error)
            finally:
                for task in workers:
                    task.cancel()
                await asyncio.gather(*workers, return_exceptions=True)
                await self.sender.close()
                # Also after an interruption.
                run = Run(self.folder, config, sorted(self._flights, key=lambda run: run.index), budget, fatal)
                write_records(run)
        return run

    async def _fly_turn(self, run: EpisodeRun) -> None:
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
                self._fatal = f"{urlsplit(self.config.base_url).netloc or self.config.model} {verb} {failed}"
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
        self._transcript.append(call)
        self.budget.count(call)
        if reading is not None:
            run.take(reading)
            self._show(run)

    async def _send(self, run: EpisodeRun, failures: list[Failure]) -> tuple[Answer, Reading, float]:
        """The answer, and its seconds without any wait for a turn; appends each failed try to `failures`."""
        options = self.budget.options
        while True:
            await self.budget.turn()
            sent = time.monotonic()
            try:
                answer = await self.sender.send(run.request(self._changes), str(run.key))
                latency = time.monotonic() - sent
                return answer, run.read(answer), latency
            except TryFailedError as error:
                failed = error
            if failed.changes:
                # Each part is rejected once at most, so this ends, also without tries left.
                if failed.changes.items() - self._changes.items():
                    self._changes = {**self._changes, **failed.changes}
                    print(f"{described(failed.changes)}: the endpoint returned {failed}", file=sys.stderr)
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
            if time.monotonic() - self._wait_shown >= QUIET_SECONDS:
                self._wait_shown = time.monotonic()
                attempt = f"map {run.seed}, turn {run.key.turn}: attempt {len(failures)} of {options.tries} failed"
                print(f"{attempt}: {failed}; next attempt in {wait:.1f} s", file=sys.stderr)
            await asyncio.sleep(wait)

    def _show(self, run: EpisodeRun) -> None:
        """Print the new log lines of a flight one at a time, and a line of progress if the last one is old."""
        if self._at_once == 1 and run.flown:
            lines = run.log_lines(self.config.model, self._printed)
            print(*lines, sep="\n", end="\n" if lines else "", flush=True)
            self._printed += len(lines)
        if time.monotonic() - self._line_shown >= LINE_SECONDS:
            self._line_shown = time.monotonic()
            flown = f"flights: {len(self._flights)} of {self.config.flights}; requests: {self.budget.requests}"
            print(flown, file=sys.stderr)

    def _end(self, run: EpisodeRun) -> None:
        """Store a flight and print its log lines."""
        self._flights.append(run)
        try:
            if self.store is not None and run.episode.ended:
                self.store.add_episode(run.episode, self.config.model, EpisodeIds(self.folder).of(run.index))
        except StoreError as error:
            # The flight is paid for: the run continues without the store.
            print(f"map {run.seed} is not in the store, --resume adds it: {error}", file=sys.stderr)
        print(*run.log_lines(self.config.model, self._printed), run.last_line, sep="\n", flush=True)
        self._printed = 0
        if run.status != "finished":
            print(f"map {run.seed}: {run.status}: {run.error}", file=sys.stderr)


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
