"""Many flights in one file: JSONL, one record a line, each with its own `format_version`."""

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from drone_env.episodes.record import EpisodeRecord


class RecordWriter(Protocol):
    """Writes one record, which is in the file when it returns."""

    def __call__(self, record: EpisodeRecord) -> None: ...
