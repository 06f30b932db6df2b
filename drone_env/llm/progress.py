"""Progress of a run on standard error: a bar in a terminal, a line now and then elsewhere. Waits are always shown."""

import time
from collections.abc import Callable
from statistics import fmean

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from drone_env.llm.answers import Unusable
from drone_env.llm.config import RunConfig
from drone_env.llm.flight import PilotedEpisode
from drone_env.llm.limiter import RateLimiter
from drone_env.llm.runner import Observer, log_text
from drone_env.llm.transcript import Call

LINE_SECONDS = 10.0
LONG_WAIT = 5.0
QUIET_SECONDS = 1.0


class ConsoleObserver(Observer):
    """Prints the log lines of each flight to standard output, together, and all else to standard error.

    Args:
        config: The run.
        limiter: Its rate limiter, for the figures.
        keep: Is called with each flight before its log lines are printed.

    Attributes:
        progress: The bar; enter it in a `with`.
    """

    def __init__(self, config: RunConfig, limiter: RateLimiter, keep: Callable[[PilotedEpisode], None]) -> None:
        self._config = config
        self._limiter = limiter
        self._keep = keep
        self._console = Console(stderr=True, highlight=False, markup=False, emoji=False)
        terminal = self._console.file.isatty()
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[figures]}"),
            console=self._console,
            transient=True,
            disable=not terminal,
            redirect_stdout=terminal,
        )
        self._bar = self.progress.add_task(config.task_config.short_name, total=config.flights, figures="")
        self._done = self._calls = self._answers = self._unusable = self._waits = 0
        self._scores: list[float] = []
        self._began = self._line_shown = time.monotonic()
        self._wait_shown = 0.0

    def called(self, call: Call) -> None:
        """A call was made."""
        self._calls += 1
        # The model may repair its first answer.
        if call.answer is not None and (call.outcome == "ok" or call.attempt == 2):
            self._answers += 1
            self._unusable += call.outcome != "ok"
        self._show()

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed and is repeated after a wait; `reason` names the attempt and the error."""
        self._waits += 1
        now = time.monotonic()
        if seconds >= LONG_WAIT or now - self._wait_shown >= QUIET_SECONDS:
            self._wait_shown = now
            so_far = f"{self._waits} {'retry' if self._waits == 1 else 'retries'} so far"
            self._console.print(f"{reason}; next attempt in {seconds:.1f} s ({so_far})", soft_wrap=True)

    def flown(self, flown: PilotedEpisode) -> None:
        """A flight is over."""
        self._keep(flown)
        print(log_text(flown, self._config.model), end="", flush=True)
        self._done += 1
        if flown.status != "errored":
            self._scores.append(flown.episode.counted_score())
        if flown.status != "finished":
            self._console.print(f"map {flown.episode.seed}: {flown.status}: {flown.error}")
        self._show()

    def _show(self) -> None:
        now, limiter = time.monotonic(), self._limiter
        if self.progress.disable and now - self._line_shown < LINE_SECONDS:
            return
        self._line_shown = now
        rate = self._calls / max(now - self._began, 1e-9)
        cost = "" if limiter.cost is None else f", ${limiter.cost:.4f}"
        score = f"score {fmean(self._scores):.4f}, " if self._scores else ""
        figures = (
            f"{score}unusable answers {Unusable(self._unusable, self._answers)}, {limiter.requests} requests, "
            f"{rate:.1f} calls/s, {limiter.active} at once, {limiter.tokens} tokens{cost}"
        )
        if self.progress.disable:
            self._console.print(f"{self._done} of {self._config.flights} flights, {figures}", soft_wrap=True)
        self.progress.update(self._bar, completed=self._done, figures=figures)
