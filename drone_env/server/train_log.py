"""The training log, for `/logs` and the page."""

from math import isfinite
from pathlib import Path

from drone_env.errors import StoreError

FILE_NAME = "train.log"
TAIL_BYTES = 256 * 1024
CURVE_BYTES = 32 * 1024 * 1024
POINTS = 400


def tail(folder: Path, lines: int) -> list[str]:
    """Return the last lines of the log in a data folder, oldest first, from at most 256 KiB. Empty without a file."""
    return _end(folder, TAIL_BYTES)[-lines:]


def metrics(folder: Path) -> dict[str, list[float | None]]:
    """Return the metrics of the training by name; empty without a file.

    It reads at most 32 MiB and samples at most 400 lines evenly, including the last. Lines consist of `name=value`,
    as `drone_env.rl.run.log_line` writes them; lines with other names than the first are skipped.
    """
    lines = _end(folder, CURVE_BYTES)
    sample = lines[:: -max(1, -(-len(lines) // POINTS))][::-1]
    rows = [row for row in map(_metrics_of, sample) if row]
    return {name: [row[name] for row in rows if row.keys() == rows[0].keys()] for name in rows[0]} if rows else {}


def _end(folder: Path, size: int) -> list[str]:
    """Return the last lines, of at most `size` bytes. Empty without a file.

    Raises:
        StoreError: if it cannot be read.
    """
    try:
        with open(folder / FILE_NAME, "rb") as file:
            start = max(file.seek(0, 2) - size, 0)
            file.seek(start)
            text = file.read(size).decode("utf-8", "replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StoreError(f"{FILE_NAME} cannot be read: {error.strerror}") from None
    return text.splitlines()[1 if start else 0 :]


def _metrics_of(line: str) -> dict[str, float | None]:
    """Return the metrics of a line; empty if it has none."""
    parts = [part.partition("=") for part in line.split()]
    try:
        values = {name: None if value == "-" else float(value) for name, _, value in parts}
    except ValueError:
        return {}
    # JSON has no NaN.
    return {name: value if value is not None and isfinite(value) else None for name, value in values.items()}
