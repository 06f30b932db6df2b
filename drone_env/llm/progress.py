"""Progress of a run on standard error: a line every ten seconds, and each wait."""

import sys
import time
from statistics import fmean

from drone_env.errors import StoreError
from drone_env.llm.answers import Unusable
from drone_env.llm.config import RunConfig
from drone_env.llm.flight import PilotedEpisode
from drone_env.llm.limiter import RateLimiter
from drone_env.llm.run_folder import RunFolder
from drone_env.llm.runner import Observer, log_text
from drone_env.llm.transcript import Call
from drone_env.results.store import Store

LINE_SECONDS = 10.0
LONG_WAIT = 5.0
QUIET_SECONDS = 1.0


class ConsoleObserver(Observer):
    """Prints the log lines of each flight to standard output, together, and all else to standard error.

    Args:
        config: The run.
        limiter: Its rate limiter, for the figures.
        folder: Its folder.
        store: Gets each whole flight before its log lines are printed; None to store none.

    Attributes:
        not_stored: Why flights are not in the store.
    """

    def __init__(self, config: RunConfig, limiter: RateLimiter, folder: RunFolder, store: Store | None) -> None:
        self.not_stored: list[str] = []
        self._config = config
        self._limiter = limiter
        self._folder = folder
        self._store = store
        self._done = self._calls = self._answers = self._unusable = self._retries = 0
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
        self._retries += 1
        now = time.monotonic()
        if seconds >= LONG_WAIT or now - self._wait_shown >= QUIET_SECONDS:
            self._wait_shown = now
            print(f"{reason}; next attempt in {seconds:.1f} s (retries so far: {self._retries})", file=sys.stderr)

    def flown(self, flown: PilotedEpisode) -> None:
        """A flight is over."""
        try:
            if self._store is not None:
                self._folder.keep(flown, self._store)
        except StoreError as error:
            # The flight is paid: the run continues without the store.
            self.not_stored.append(str(error))
        print(log_text(flown, self._config.model), end="", flush=True)
        self._done += 1
        if flown.status != "errored":
            self._scores.append(flown.episode.counted_score())
        if flown.status != "finished":
            print(f"map {flown.episode.seed}: {flown.status}: {flown.error}", file=sys.stderr)
        self._show()

    def _show(self) -> None:
        now, limiter = time.monotonic(), self._limiter
        if now - self._line_shown < LINE_SECONDS:
            return
        self._line_shown = now
        rate = self._calls / max(now - self._began, 1e-9)
        cost = "" if limiter.cost is None else f", ${limiter.cost:.4f}"
        score = f"score {fmean(self._scores):.4f}, " if self._scores else ""
        print(
            f"{self._done} of {self._config.flights} flights, {score}unusable answers "
            f"{Unusable(self._unusable, self._answers)}, {limiter.requests} requests, {rate:.1f} calls/s, "
            f"{limiter.active} at once, {limiter.tokens} tokens{cost}",
            file=sys.stderr,
        )
