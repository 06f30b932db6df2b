"""Many flights in one file: JSONL, one record a line, each with its own `format_version`."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path

from typing_extensions import Self

from drone_env.errors import InvalidValueError
from drone_env.files import read_lines
from drone_env.results.record import LONGEST_RECORD, EpisodeRecord, parse_record


class RecordWriter:
    """Appends records to a JSONL file, making it where it is missing. To be used in a `with`, or closed.

    A record is in the file when `write` returns; a process that dies while it writes leaves at most a cut last line.

    Raises:
        OSError: if the file cannot be opened.
        InvalidValueError: if its last line is cut or no record; the file is left as it was.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._file = self._path.open("ab+", buffering=0)
        try:
            self._check_last_line()
        except BaseException:
            self._file.close()
            raise

    def write(self, record: EpisodeRecord) -> None:
        """Append one record.

        Raises:
            OSError: if it cannot be written; a part of the line may be in the file then.
        """
        line = f"{record.to_json()}\n".encode()
        written = self._file.write(line)
        if written != len(line):
            raise OSError(f"only {written} of {len(line)} bytes could be written to {self._path}")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _check_last_line(self) -> None:
        if not self._path.is_file():
            return  # a pipe or a device, which holds no lines
        last = b"".join(deque(read_lines(self._path, LONGEST_RECORD), 1))
        name = f"the last line of {self._path}"
        if last.endswith(b"\n"):
            parse_record(last, name)
        elif last:
            try:
                parse_record(last, name)
            except InvalidValueError:
                raise InvalidValueError(f"{name} is cut; remove it before more are appended") from None
            self._file.write(b"\n")


def read_records(path: str | Path) -> Iterator[EpisodeRecord]:
    """The records of a JSONL file, one at a time; empty lines are passed over.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: at the first line that is not a record, with its number; the records before it have been
            given out by then. A last line that is cut is said to be so.
    """
    for _, record in numbered_records(path):
        yield record


def numbered_records(path: str | Path) -> Iterator[tuple[int, EpisodeRecord]]:
    """As `read_records`, each with the number of its line, from 1."""
    for number, line in enumerate(read_lines(path, LONGEST_RECORD), 1):
        if not line.strip():
            continue
        name = f"line {number} of {path}"
        try:
            record = parse_record(line, name)
        except InvalidValueError as error:
            if line.endswith(b"\n"):
                raise
            raise InvalidValueError(f"the last line is cut, and all before it are whole: {error}") from None
        yield number, record
