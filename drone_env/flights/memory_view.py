"""`memory.json`: the last 100 finished episodes as a file for people and scripts."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from drone_env.errors import DroneEnvError
from drone_env.files import write_text

LENGTH = 100
PAUSE_SECONDS = 0.05
HEAD = '{"format": "drone_env/memory", "format_version": 1, "episodes": [\n'
TAIL = "\n]}\n"
log = logging.getLogger(__name__)

Newer = Callable[[int], Sequence[tuple[int, str]]]


class MemoryView:
    """Replaces the file in its own thread, since replacing a file may wait for the disk.

    One replacement shows all episodes that end within `PAUSE_SECONDS`.

    Args:
        path: The file.
        newer: Returns number and JSON of the last `LENGTH` episodes after a number, oldest first; "" leaves one out.
    """

    def __init__(self, path: Path, newer: Newer) -> None:
        self._path = path
        self._newer = newer
        self._lines: deque[tuple[int, str]] = deque(maxlen=LENGTH)
        self._is_written = False
        self._lock = threading.Lock()
        self._due = False
        self._closing = threading.Event()
        self._thread = ThreadPoolExecutor(1, "drone_env-memory-view")
        self.refresh()

    def refresh(self) -> None:
        """Replace the file soon. Errors are logged; the next episode tries again."""
        with self._lock:
            if not (self._due or self._closing.is_set()):
                self._due = True
                self._thread.submit(self._refresh)

    def close(self) -> None:
        """Finish a due replacement; a second call does nothing."""
        with self._lock:
            self._closing.set()
        self._thread.shutdown()

    def _refresh(self) -> None:
        self._closing.wait(PAUSE_SECONDS)
        with self._lock:
            self._due = False
        try:
            # Each process reads again after it writes, so no older view stays over a newer one.
            while (found := self._newer(self._lines[-1][0] if self._lines else 0)) or not self._is_written:
                self._lines.extend(found)
                write_text(self._path, HEAD + ",\n".join([line for _, line in self._lines if line]) + TAIL)
                self._is_written = True
        except (OSError, DroneEnvError) as error:
            # The episode is safe in the store: its caller must not get an error.
            self._is_written = False
            log.warning("%s could not be written: %s", self._path, error)
