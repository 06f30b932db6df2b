"""`memory.json`: the last 100 finished episodes as a file that people and scripts can read."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.files import open_file, write_text
from drone_env.results.finished import StoredEpisode

LENGTH = 100
PAUSE_SECONDS = 0.05
LEFTOVER_SECONDS = 60.0
MARK = '{"format": "drone_env/memory"'
HEAD = MARK + ', "format_version": 1, "episodes": [\n'
TAIL = "\n]}\n"
log = logging.getLogger(__name__)

Newer = Callable[[int, int], Sequence[tuple[int, StoredEpisode]]]


class MemoryView:
    """Writes the file, in a thread of its own; each reader finds it whole.

    The thread is there because replacing a file may wait for the disk, which no flight should. Episodes that are
    finished while it writes go into the file together.

    Args:
        path: The file.
        newer: Gives the last `n` episodes of those stored after number `after`, oldest first, with their numbers:
            `newer(after, n)`.
    """

    def __init__(self, path: Path, newer: Newer) -> None:
        self._path = path
        self._newer = newer
        self._lines: deque[tuple[int, str]] = deque(maxlen=LENGTH)
        self._remove_leftovers()
        self._look()
        self._write()
        self._lock = threading.Lock()
        self._due = False
        self._closing = threading.Event()
        self._thread = ThreadPoolExecutor(1, "drone_env-memory-view")

    def refresh(self) -> None:
        """Have the file written again, soon. What goes wrong then is logged, and tried again with the next episode."""
        with self._lock:
            if not (self._due or self._closing.is_set()):
                self._due = True
                self._thread.submit(self._refresh)

    def close(self) -> None:
        """Write what is due now; a second call does nothing."""
        with self._lock:
            self._closing.set()
        self._thread.shutdown()

    def _refresh(self) -> None:
        self._closing.wait(PAUSE_SECONDS)
        with self._lock:
            self._due = False
        try:
            # The last to write looks last, so no process can leave an older view over a newer one.
            while self._look():
                self._write()
        except DroneEnvError as error:
            log.warning("%s could not be written: %s", self._path, error)

    def _look(self) -> bool:
        found = self._newer(self._lines[-1][0] if self._lines else 0, LENGTH)
        self._lines.extend((number, stored.model_dump_json(exclude_none=True)) for number, stored in found)
        return bool(found)

    def _write(self) -> None:
        text = HEAD + ",\n".join([line for _, line in self._lines]) + TAIL
        try:
            self._keep_what_is_not_ours()
            write_text(self._path, text)
        except (OSError, InvalidValueError) as error:
            # The episode is safe in the store: its caller must not get an error.
            log.warning("%s could not be written: %s", self._path, error)

    def _keep_what_is_not_ours(self) -> None:
        """Give a file that is no such view another name: it may be the history of another program."""
        try:
            with open_file(self._path) as file:
                head = file.read(len(MARK))
        except FileNotFoundError:
            return
        if head in (b"", MARK.encode()):
            return
        aside = self._path.with_name(f"{self._path.stem}.kept-{time.time_ns()}{self._path.suffix}")
        self._path.rename(aside)
        log.warning("%s was not written by drone-env: it is kept as %s", self._path, aside)

    def _remove_leftovers(self) -> None:
        """Remove what killed processes left of views that they were writing."""
        for path in self._path.parent.glob(f"{self._path.name}.*.part"):
            with suppress(FileNotFoundError):  # another process was faster
                if time.time() - path.stat().st_mtime > LEFTOVER_SECONDS:
                    path.unlink()
