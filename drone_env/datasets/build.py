"""`build_dataset`: from a configuration to a folder."""

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.formats import MINARI_FOLDER, PARQUET_FILE, Write, columns, minari_writer, parquet_writer
from drone_env.datasets.trajectories import Trajectory, fly_map
from drone_env.errors import InvalidValueError, needs

WRITERS: dict[str, Callable[[Path, DatasetConfig], AbstractContextManager[Write]]] = {
    "parquet": parquet_writer,
    "minari": minari_writer,
}

ROWS_PER_GROUP = 1 << 14
"""Rows in memory before they are written."""


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
        InvalidValueError: if there is no such format, or none is named, or the folder is not empty or cannot be made.
        MissingPackageError: if a format's package is not installed.
        TooLargeError: if the exact values of a map would take too much memory.
        OSError: if it cannot be written.
    """
    if not formats or set(formats) - WRITERS.keys():
        raise InvalidValueError(f"formats must be one or more of {', '.join(WRITERS)}; got {', '.join(formats)}")
    if not out.name or not out.parent.is_dir():
        raise InvalidValueError(f"the data set takes a folder in one that exists, got {str(out)!r}")
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise InvalidValueError(f"{out} is there and not an empty folder: name another")
    # Beside its place, so that moving it there is one step of the same file system.
    with TemporaryDirectory(prefix=f"{out.name}.", suffix=".part", dir=out.parent) as temporary:
        folder = Path(temporary) / "dataset"
        folder.mkdir()
        rows = _write(config, folder, formats, rows_per_group, on_map)
        (folder / "README.md").write_text(_card(config, tuple(formats), rows), encoding="utf-8")
        if out.exists():
            out.rmdir()
        folder.rename(out)
    return rows


def _write(
    config: DatasetConfig, folder: Path, formats: Sequence[str], rows_per_group: int, on_map: Callable[[], object]
) -> int:
    """Write all flights, whole ones in each row group, and return the number of rows."""
    rows, batch = 0, list[Trajectory]()
    with ExitStack() as stack:
        writers = [stack.enter_context(WRITERS[name](folder, config)) for name in dict.fromkeys(formats)]
        for seed in config.seeds:
            for trajectory in fly_map(config, seed):
                batch.append(trajectory)
                rows += trajectory.steps
                last = trajectory.number == config.episodes - 1
                if last or sum(one.steps for one in batch) >= rows_per_group:
                    for write in writers:
                        write(batch)
                    batch = []
            on_map()
    return rows


def _card(config: DatasetConfig, formats: tuple[str, ...], rows: int) -> str:
    """The page that says what the data set holds: Markdown with the front matter that data set hubs read."""
    with needs("data"):
        from drone_env.results.pages import render

    return render(
        "dataset.md",
        config=config,
        task=config.task,
        columns=columns(config.task),
        formats=formats,
        rows=rows,
        parquet=PARQUET_FILE,
        minari=MINARI_FOLDER,
        dataset_id=config.minari_id,
        about=json.dumps(config.as_json(), indent=2),
    )
