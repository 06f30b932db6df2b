"""`build_dataset`: from a configuration to a folder."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

from drone_env.datasets.card import card
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.minari_writer import MinariWriter
from drone_env.datasets.parquet_writer import ParquetWriter
from drone_env.datasets.trajectories import Trajectory, fly_map
from drone_env.errors import InvalidValueError, UnknownNameError

WRITERS: dict[str, Callable[[Path, DatasetConfig], ParquetWriter | MinariWriter]] = {
    "parquet": ParquetWriter,
    "minari": MinariWriter,
}

ROWS_PER_GROUP = 1 << 14
"""Rows after which they are written: the memory that a data set takes, whatever its size."""


def build_dataset(
    config: DatasetConfig,
    out: Path,
    formats: Sequence[str] = tuple(WRITERS),
    rows_per_group: int = ROWS_PER_GROUP,
    on_map: Callable[[], object] = lambda: None,
) -> int:
    """Fly and write a data set, so that its folder is there whole or not at all.

    Args:
        config: What to fly.
        out: The folder, in one that exists; it must not be there yet, or be empty.
        formats: `parquet`, `minari` or both.
        rows_per_group: Rows after which a row group ends, at the end of a flight.
        on_map: Called after each map.

    Returns:
        The number of rows.

    Raises:
        UnknownNameError: if there is no such format.
        InvalidValueError: if no format is named, or the folder is not empty or cannot be made there.
        MissingPackageError: if a format's package is not installed.
        TooLargeError: if the exact values of a map would take too much memory.
        OSError: if it cannot be written.
    """
    for name in formats:
        if name not in WRITERS:
            raise UnknownNameError("format", name, WRITERS)
    if not formats:
        raise InvalidValueError(f"formats must be one or more of {', '.join(WRITERS)}")
    if not out.name or not out.parent.is_dir():
        raise InvalidValueError(f"the data set takes a folder in one that exists, got {str(out)!r}")
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InvalidValueError(f"{out} is there and not an empty folder: name another")
    # Beside its place, so that moving it there is one step of the same file system.
    with TemporaryDirectory(prefix=f"{out.name}.", suffix=".part", dir=out.parent) as temporary:
        folder = Path(temporary) / "dataset"
        folder.mkdir()
        rows = _write(config, folder, formats, rows_per_group, on_map)
        (folder / "README.md").write_text(card(config, tuple(formats), rows), encoding="utf-8")
        if out.exists():
            out.rmdir()
        folder.rename(out)
    return rows


def _write(
    config: DatasetConfig, folder: Path, formats: Sequence[str], rows_per_group: int, on_map: Callable[[], object]
) -> int:
    rows = episodes = 0
    with ExitStack() as stack:
        writers = [stack.enter_context(closing(WRITERS[name](folder, config))) for name in dict.fromkeys(formats)]
        for batch in _batches(_fly_all(config, on_map), rows_per_group):
            for writer in writers:
                writer.write(episodes, batch)
            episodes += len(batch)
            rows += sum(trajectory.steps for trajectory in batch)
    return rows


def _fly_all(config: DatasetConfig, on_map: Callable[[], object]) -> Iterator[Trajectory]:
    for seed in config.seeds:
        yield from fly_map(config, seed)
        on_map()


def _batches(trajectories: Iterable[Trajectory], rows: int) -> Iterator[list[Trajectory]]:
    """Whole flights, of at least `rows` steps together; the last ones of what is left."""
    batch: list[Trajectory] = []
    steps = 0
    for trajectory in trajectories:
        batch.append(trajectory)
        steps += trajectory.steps
        if steps >= rows:
            yield batch
            batch, steps = [], 0
    if batch:
        yield batch
