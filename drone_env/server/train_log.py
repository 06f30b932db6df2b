"""The end of `train.log`, which training writes into the data folder."""

from collections import deque
from pathlib import Path

from drone_env.files import stamp

FILE_NAME = "train.log"
TAIL_BYTES = 256 * 1024


class TrainLog:
    """The log in a folder, there or not.

    Args:
        folder: The data folder.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE_NAME
        self._seen: object = False

    def has_changed(self) -> bool:
        """Whether it is another one than at the last call; true at the first."""
        before, self._seen = self._seen, stamp(self.path)
        return self._seen != before

    def tail(self, lines: int) -> list[str]:
        """Its last lines, oldest first; none where there is no file. Reads at most its last 256 KiB."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                start = max(size - TAIL_BYTES, 0)
                file.seek(start)
                text = file.read(TAIL_BYTES).decode("utf-8", "replace")
        except FileNotFoundError:
            return []
        found = text.splitlines()
        return list(deque(found[1:] if start else found, lines))
