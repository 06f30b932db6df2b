"""What a run prints: the log lines of the flights, a line of progress every ten seconds, and each wait."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from drone_env.envs.ansi import end_line, start_line, step_line
from drone_env.errors import StoreError
from drone_env.flights.store import Store
from drone_env.llm.budget import Budget
from drone_env.llm.config import RunConfig
from drone_env.llm.run_folder import EpisodeIds
from drone_env.llm.text_episode import EpisodeRun

LINE_SECONDS = 10.0
QUIET_SECONDS = 1.0


@dataclass
class Progress:
    """Prints the log lines of each flight to standard output, and everything else to standard error.

    The lines of a flight stay together. Of flights one at a time, each line is printed as it happens.

    Attributes:
        config: The run.
        budget: Its requests and tokens.
        folder: Its folder.
        store: Gets each finished episode, once however often the run is resumed; None to store none.
    """

    config: RunConfig
    budget: Budget
    folder: Path
    store: Store | None = None
    _flights: int = 0
    _printed: int = 0  # lines of the flight
    _line_shown: float = field(default_factory=time.monotonic)
    _wait_shown: float = 0.0

    def __post_init__(self) -> None:
        self._one_by_one = min(self.config.flights, self.budget.options.concurrency) == 1

    def on_steps(self, run: EpisodeRun) -> None:
        """Print the new log lines of a flight, and a line of progress if the last one is old."""
        if self._one_by_one:
            self._print(run)
        now = time.monotonic()
        if now - self._line_shown >= LINE_SECONDS:
            self._line_shown = now
            self.notice(f"flights: {self._flights} of {self.config.flights}; requests: {self.budget.requests}")

    def on_wait(self, text: str) -> None:
        """Print the wait before a retry, at most one a second."""
        now = time.monotonic()
        if now - self._wait_shown >= QUIET_SECONDS:
            self._wait_shown = now
            self.notice(text)

    def notice(self, text: str) -> None:
        """Print a line to standard error."""
        print(text, file=sys.stderr)

    def on_flight(self, run: EpisodeRun) -> None:
        """Store the flight and print its log lines."""
        try:
            if self.store is not None and run.episode.ended:
                self.store.add_episode(run.episode, self.config.model, EpisodeIds(self.folder).of(run.index))
        except StoreError as error:
            # The flight is paid for: the run continues without the store.
            self.notice(f"map {run.seed} is not in the store, --resume adds it: {error}")
        self._print(run)
        print(last_line(run), flush=True)
        self._printed = 0
        self._flights += 1
        if run.status != "finished":
            self.notice(f"map {run.seed}: {run.status}: {run.error}")

    def _print(self, run: EpisodeRun) -> None:
        lines = log_lines(run, self.config.model, self._printed)
        print(*lines, sep="\n", end="\n" if lines else "", flush=True)
        self._printed += len(lines)


def log_lines(run: EpisodeRun, model: str, printed: int = 0) -> list[str]:
    """The log lines of a flight so far.

    A step with an unusable answer shows the outcome of that answer as its error.

    Args:
        run: The flight.
        model: Name of the pilot.
        printed: Number of lines to leave out.
    """
    first = max(printed - 1, 0)
    start = [] if printed else [start_line(run.episode.task, model)]
    return start + [step_line(number, *step) for number, step in enumerate(run.flown[first:], first + 1)]


def last_line(run: EpisodeRun) -> str:
    """The line of the end of a flight.

    The score of a flight that a limit stopped is that of waiting to the end; an errored flight has no score.
    """
    return end_line(run.success, None if run.status == "errored" else run.score, run.episode.rewards)
