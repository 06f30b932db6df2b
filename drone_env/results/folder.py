"""The folder of an evaluation: its configuration, and one file per chunk of its results."""

import os
import tarfile
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np
from typing_extensions import Self

from drone_env import __version__
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, TooLargeError
from drone_env.files import is_begun, read_file, replacing, write_json
from drone_env.models import StrictModel
from drone_env.results.result import COLUMNS, MAPS_PER_CHUNK, EpisodesKey, Results, concatenate

CONFIG, CHUNKS = "evaluation.json", "pieces"
MOST_BYTES = 1 << 20
"""Maximum bytes of a configuration and of a chunk; 1,000 episodes take 38,000."""
SHIPPED = Path(__file__).with_name("shipped.tar.xz")
"""The evaluation of docs/benchmark.md: an archive of its folder, read like one. tools/docs_generate.py writes it."""


class EvaluationConfig(StrictModel):
    """Everything that determines the results of an evaluation."""

    format: Literal["drone_env/evaluation"] = "drone_env/evaluation"
    format_version: Literal[1] = 1
    package: str = __version__
    keys: list[EpisodesKey]

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the configuration in a folder."""
        path = folder / CONFIG
        return cls.read(_read(path), f"{path} is not the configuration of an evaluation")


class ResultsFolder:
    """The results of an evaluation in chunks, from which a stopped evaluation resumes.

    A chunk is one file, named by its key and written atomically.

    Args:
        path: The folder; it is created if it is missing.
        keys: The keys of the evaluation.

    Raises:
        OSError: if it cannot be created or read.
        InvalidValueError: if it contains another evaluation, one of another version of this package, or other files.
    """

    def __init__(self, path: Path, keys: Sequence[EpisodesKey]) -> None:
        self._chunks, config = path / CHUNKS, EvaluationConfig(package=__version__, keys=list(keys))
        if is_begun(path, CONFIG, "an evaluation"):
            stored = EvaluationConfig.load(path)
            if stored.package != config.package:
                raise InvalidValueError(f"{path} holds an evaluation by version {stored.package} of this package")
            if changed := {*stored.keys} ^ {*keys}:
                raise InvalidValueError(f"{path} holds another evaluation: only one of the two has {min(changed)}")
        else:
            write_json(path / CONFIG, config.model_dump())

    def load(self, key: EpisodesKey) -> Results | None:
        """Return the results of a chunk; None if it is missing."""
        return _load(_file(self._chunks, key), key)

    def save(self, results: Results) -> None:
        """Write the results of a chunk."""
        with replacing(_file(self._chunks, results.key)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: getattr(results, name) for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())


def stored_results(
    path: Path, task: str | None = None, most: int | None = None
) -> list[tuple[str, tuple[Results, ...]]]:
    """Return the results in the folder of a complete evaluation: agent and repeats, for each agent and task.

    Args:
        path: The folder.
        task: Read only this task; None for all.
        most: Maximum number of maps.

    Raises:
        OSError: if it cannot be read.
        TooLargeError: if there are more maps.
        InvalidValueError: if it is not an evaluation, is damaged, or chunks are missing.
        UnknownNameError: if a task is not registered.
    """
    found: dict[tuple[str, str], list[Results]] = {}
    for key in EvaluationConfig.load(path).keys:
        if task not in (None, key.task):
            continue
        n = key.seeds[1] - key.seeds[0]
        if most is not None and n > most:
            raise TooLargeError(f"it has {n} maps; at most {most} are ranked here")
        get_task(key.task, key.version)
        chunks = [_load(_file(path / CHUNKS, chunk), chunk) for chunk in key.chunks()]
        there = [chunk for chunk in chunks if chunk is not None]
        if len(there) < len(chunks):
            missing = len(chunks) - len(there)
            raise InvalidValueError(f"{missing} of {len(chunks)} pieces of {key.agent} on {key.task} are not flown yet")
        found.setdefault((key.agent, key.task), []).append(concatenate(there, key))
    return [(agent, tuple(repeats)) for (agent, _), repeats in found.items()]


def shipped_results(key: EpisodesKey) -> Results | None:
    """Return the results of a key from the shipped evaluation; None if it does not have all these maps."""
    first, stop = key.seeds
    chunk = key._replace(seeds=(first, first + MAPS_PER_CHUNK))
    found = _load(_file(SHIPPED / CHUNKS, chunk), chunk) if stop <= chunk.seeds[1] else None
    return None if found is None else replace(found.take(np.arange(stop - first)), key=key)


@lru_cache(maxsize=1)
def _shipped_files() -> dict[str, bytes]:
    with tarfile.open(SHIPPED) as archive:
        files = ((member.name, archive.extractfile(member)) for member in archive)
        return {Path(name).name: file.read() for name, file in files if file is not None}


def _read(path: Path) -> bytes:
    if SHIPPED not in path.parents:
        return read_file(path, MOST_BYTES)
    if path.name not in _shipped_files():
        raise FileNotFoundError(path)
    return _shipped_files()[path.name]


def _file(folder: Path, key: EpisodesKey) -> Path:
    again = f"-again{key.repeat}" if key.repeat else ""
    return folder / f"{key.task}-v{key.version}-{key.config_hash}-{key.seeds[0]}-{key.seeds[1]}{again}.npz"


def _load(path: Path, key: EpisodesKey) -> Results | None:
    try:
        with np.load(BytesIO(_read(path)), allow_pickle=False) as archive:
            columns: dict[str, Any] = {name: archive[name] for name in COLUMNS}
        shape = (key.seeds[1] - key.seeds[0],)
        if any(columns[name].dtype != kind or columns[name].shape != shape for name, kind in COLUMNS.items()):
            raise ValueError(f"its columns have other types or lengths than those of {shape[0]} maps")
        if not np.array_equal(columns["seeds"], np.arange(*key.seeds)):
            raise ValueError("it has other maps")
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        reason = str(error).removeprefix(f"{path} ")
        raise InvalidValueError(f"{path} is damaged ({reason}): delete it, and its maps are flown again") from None
    return Results(key, **columns)
