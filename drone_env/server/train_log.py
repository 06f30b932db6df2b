"""The end of the training log, for `/logs` and the page."""

from pathlib import Path

from drone_env.errors import StoreError

FILE_NAME = "train.log"
TAIL_BYTES = 256 * 1024


def tail(folder: Path, lines: int) -> list[str]:
    """Return the last lines of the log in a data folder, oldest first, from at most 256 KiB. Empty without a file.

    Raises:
        StoreError: if it cannot be read.
    """
    try:
        with open(folder / FILE_NAME, "rb") as file:
            start = max(file.seek(0, 2) - TAIL_BYTES, 0)
            file.seek(start)
            text = file.read(TAIL_BYTES).decode("utf-8", "replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise StoreError(f"{FILE_NAME} cannot be read: {error.strerror}") from None
    return text.splitlines()[1 if start else 0 :][-lines:]
