"""`train.log`, which training writes into the data folder: its end, and its figures."""

from collections import deque
from math import isfinite
from pathlib import Path

from drone_env.errors import InvalidValueError, StoreError
from drone_env.files import open_file, stamp

FILE_NAME = "train.log"
TAIL_BYTES = 256 * 1024
CURVE_BYTES = 32 * 1024 * 1024
POINTS = 400


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
        return list(deque(self._end(TAIL_BYTES), lines))

    def curve(self) -> dict[str, list[float | None]]:
        """The figures of the last training by name, in the order of its lines; none where there are no such lines.

        At most 400 lines, evenly spread, the last among them, of the last 32 MiB. A line has figures where it is all
        `name=value`, as `drone_env.rl.run.log_line` writes it, and as the first of them; null is what there is not yet.
        """
        lines = self._end(CURVE_BYTES)
        chosen = lines[:: -max(1, -(-len(lines) // POINTS))][::-1]
        rows = [row for row in map(_figures, chosen) if row]
        return {name: [row[name] for row in rows if row.keys() == rows[0].keys()] for name in rows[0]} if rows else {}

    def _end(self, size: int) -> list[str]:
        """Its last lines, of at most so many bytes; none where there is no file.

        Raises:
            StoreError: if it cannot be read.
        """
        try:
            with open_file(self.path) as file:
                start = max(file.seek(0, 2) - size, 0)
                file.seek(start)
                text = file.read(size).decode("utf-8", "replace")
        except FileNotFoundError:
            return []
        except (InvalidValueError, OSError) as error:
            why = getattr(error, "strerror", None) or str(error).removeprefix(f"{self.path} ")
            raise StoreError(f"{FILE_NAME} cannot be read: {why}") from None
        return text.splitlines()[1 if start else 0 :]


def _figures(line: str) -> dict[str, float | None]:
    """The figures of a line; none where it is another one."""
    parts = [part.partition("=") for part in line.split()]
    try:
        values = [None if value == "-" else float(value) for _, _, value in parts]
    except ValueError:
        return {}
    # JSON has no NaN.
    finite = [value if value is not None and isfinite(value) else None for value in values]
    return {name: value for (name, _, _), value in zip(parts, finite, strict=True)}
