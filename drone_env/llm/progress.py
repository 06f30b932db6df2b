"""What a run prints: the log lines of the flights, a line of progress every ten seconds, and each wait."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from drone_env.core.actions import Action
from drone_env.envs.ansi import end_line, start_line, step_line
from drone_env.errors import StoreError
from drone_env.llm.answers import Reading, in_common
from drone_env.llm.config import RunConfig
from drone_env.llm.limiter import Budget
from drone_env.llm.run_folder import EpisodeIds
from drone_env.llm.text_episode import Flight
from drone_env.results.store import Store
from drone_env.results.tables import known_sum

LINE_SECONDS = 10.0
LONG_WAIT = 5.0
QUIET_SECONDS = 1.0
EARLY = 10
"""The number of answers after which a run without a usable one prints what they have in common."""


@dataclass
class Progress:
    """Prints the log lines of each flight to standard output, and everything else to standard error.

    The lines of a flight stay together. Of flights one at a time, each line is printed as it happens.

    Attributes:
        config: The run.
        budget: Its requests and tokens.
        folder: Its folder.
        one_at_a_time: Whether a flight begins only after the end of the one before.
        store: Gets each finished episode, once however often the run is resumed; None to store none.
        not_stored: The errors of flights that are not in the store.
    """

    config: RunConfig
    budget: Budget
    folder: Path
    one_at_a_time: bool = False
    store: Store | None = None
    not_stored: list[str] = field(default_factory=list[str])
    _flights: int = 0
    _printed: int = 0  # letters of the flight
    _retries: int = 0
    _line_shown: float = field(default_factory=time.monotonic)
    _wait_shown: float = 0.0
    _early: list[Reading] | None = field(default_factory=list[Reading])

    def on_request(self, flight: Flight) -> None:
        """Print the new log lines of the flight that a request belongs to."""
        if self.one_at_a_time:
            self._print(log_text(flight, self.config.model, whole=False))

    def _print(self, text: str) -> None:
        print(text[self._printed :], end="", flush=True)
        self._printed = len(text)

    def on_call(self) -> None:
        """Print a line of progress if the last one is old."""
        now, budget = time.monotonic(), self.budget
        if now - self._line_shown >= LINE_SECONDS:
            self._line_shown = now
            flights = f"{self._flights} of {self.config.flights} flights"
            cost = "" if budget.cost is None else f", {known_sum(budget.cost, budget.unmetered, '.4f')} US dollars"
            tokens = "" if budget.tokens is None else f", {known_sum(budget.tokens, budget.unmetered, 'd')} tokens"
            print(f"{flights}, {budget.requests} requests{tokens}{cost}", file=sys.stderr)

    def on_reading(self, reading: Reading) -> None:
        """If none of the first answers is usable, print once what they have in common."""
        if reading.kind == "ok":
            self._early = None
        elif self._early is not None:
            self._early.append(reading)
            if len(self._early) == EARLY:
                print(f"no usable answer so far: {in_common(self._early)}", file=sys.stderr)
                self._early = None

    def on_wait(self, seconds: float, reason: str) -> None:
        """Print the wait before a retry, at most one short wait per second."""
        self._retries += 1
        now = time.monotonic()
        if seconds >= LONG_WAIT or now - self._wait_shown >= QUIET_SECONDS:
            self._wait_shown = now
            print(f"{reason}; next attempt in {seconds:.1f} s (retries so far: {self._retries})", file=sys.stderr)

    def notice(self, text: str) -> None:
        """Print what happens once in a run."""
        print(text, file=sys.stderr)

    def on_flight(self, flight: Flight) -> None:
        """Store the flight and print its log lines."""
        try:
            if self.store is not None and flight.episode.ended:
                self.store.add_episode(flight.episode, self.config.model, EpisodeIds(self.folder).of(flight.index))
        except StoreError as error:
            # The flight is paid for: the run continues without the store.
            self.not_stored.append(str(error))
        self._print(log_text(flight, self.config.model))
        self._printed = 0
        self._flights += 1
        if flight.status != "finished":
            print(f"map {flight.episode.seed}: {flight.status}: {flight.error}", file=sys.stderr)


def log_text(flight: Flight, model: str, whole: bool = True) -> str:
    """The log lines of a flight, each with its newline.

    A step with an unusable answer shows the outcome of that answer as its error. A flight that a limit stopped has
    fewer steps, and its score is that of waiting to the end; an errored flight has no score.

    Args:
        flight: The flight.
        model: Name of the pilot.
        whole: Whether to add the line of the end.
    """
    episode = flight.episode
    lines = [start_line(episode.task, model)]
    for number, (step, error) in enumerate(zip(episode.path, flight.step_errors, strict=True), 1):
        done = episode.ended and number == episode.steps
        lines.append(step_line(number, Action(step.action), step.reward, done, error))
    if whole:
        lines.append(end_line(flight.success, None if flight.status == "errored" else flight.score, flight.rewards))
    return "".join(f"{line}\n" for line in lines)
