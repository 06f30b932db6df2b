"""The folder of an evaluation: its configuration, and one file per chunk of its results."""

import os
import tarfile
import zlib
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile
from pydantic import Field, model_validator
from typing_extensions import Self

from drone_env import __version__
from drone_env.agents import network_file
from drone_env.core.rules import HIGHEST, LOWEST
from drone_env.core.seeds import N_SEEDS
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, TooLargeError, abbreviate
from drone_env.files import differences, is_begun, read_file, replacing, write_json
from drone_env.models import StrictModel
from drone_env.results.result import COLUMNS, MAPS_PER_CHUNK, EpisodesKey, Results, concatenate

CONFIG, CHUNKS = "evaluation.json", "pieces"
MOST_BYTES = 1 << 20
"""Maximum bytes of a configuration and of a chunk; 1,000 episodes take 38,000."""
MOST_CHUNKS = 1_000_000
SHIPPED = Path(__file__).with_name("shipped.tar.xz")
"""The evaluation of docs/benchmark.md: an archive of its folder, read like one. tools/docs_generate.py writes it."""
Name = Annotated[str, Field(max_length=1000)]


class EvaluationConfig(StrictModel):
    """Everything that determines the results of an evaluation. `agents` contains digests of networks, not paths."""

    format: Literal["drone_env/evaluation"] = "drone_env/evaluation"
    format_version: Literal[1] = 1
    package: Name
    piece: int = Field(ge=1, le=MOST_CHUNKS)
    split: Name
    seeds: list[Annotated[int, Field(ge=0, le=N_SEEDS)]] = Field(min_length=2, max_length=2)
    repeats: dict[Name, Annotated[int, Field(ge=2, le=MOST_CHUNKS)]] = Field(default_factory=dict)
    tasks: list[Annotated[Name, Field(pattern="^.+ v[0-9]{1,9}$")]]
    agents: dict[Name, Annotated[str, Field(pattern="^[0-9a-f]{16}$")]]

    @classmethod
    def of(cls, keys: Sequence[EpisodesKey]) -> Self:
        """Return the configuration of an evaluation of all keys."""
        first, labels = keys[0], {key: f"{(network_file(key.agent) or [key.agent])[0]} on {key.task}" for key in keys}
        return cls(
            package=__version__,
            piece=MAPS_PER_CHUNK,
            split=first.split,
            seeds=list(first.seeds),
            repeats={label: key.repeat + 1 for key, label in labels.items() if key.repeat},
            tasks=sorted({f"{key.task} v{key.version}" for key in keys}),
            agents={label: key.config_hash for key, label in labels.items()},
        )

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the configuration in a folder."""
        path = folder / CONFIG
        return cls.read(_read(path), f"{path} is not the configuration of an evaluation")

    @model_validator(mode="after")
    def _check(self) -> Self:
        start, stop = self.seeds
        if not 0 < stop - start <= MOST_CHUNKS * self.piece:
            raise ValueError(f"seeds {start}:{stop} are not 1 to {MOST_CHUNKS:,} chunks of {self.piece} maps")
        self.episodes_keys()
        return self

    def episodes_keys(self) -> list[EpisodesKey]:
        """Return the key of each agent on each of its tasks, at its first repeat."""
        versions = {task: int(version) for task, _, version in (name.rpartition(" v") for name in self.tasks)}
        keys: list[EpisodesKey] = []
        for label, digest in self.agents.items():
            agent, _, task = label.rpartition(" on ")
            if task not in versions:
                raise ValueError(f"agents: {abbreviate(label)} does not end in ' on TASK', with a task of `tasks`")
            keys.append(EpisodesKey(task, versions[task], self.split, (self.seeds[0], self.seeds[1]), agent, digest))
        return keys


class ResultsFolder:
    """The results of an evaluation in chunks, from which a stopped evaluation resumes.

    A chunk is one file, named by its key and written atomically.

    Args:
        path: The folder; it is created if it is missing.
        keys: The keys of the evaluation.

    Raises:
        OSError: if it cannot be created or read.
        InvalidValueError: if it contains another evaluation, one of another version of this package, or other files;
            the message names the differences.
    """

    def __init__(self, path: Path, keys: Sequence[EpisodesKey]) -> None:
        self._chunks, config = path / CHUNKS, EvaluationConfig.of(keys)
        if is_begun(path, CONFIG, "an evaluation"):
            changed = differences(EvaluationConfig.load(path).model_dump(), config.model_dump())
            if changed:
                raise InvalidValueError(f"{path} holds another evaluation: {'; '.join(changed)}")
        else:
            path.mkdir(parents=True, exist_ok=True)
            write_json(path / CONFIG, config.model_dump())
        self._chunks.mkdir(exist_ok=True)

    def load(self, key: EpisodesKey) -> Results | None:
        """Return the results of a chunk; None if it is missing."""
        return _load(_file(self._chunks, key), key)

    def save(self, results: Results) -> None:
        """Write the results of a chunk."""
        with replacing(_file(self._chunks, results.key)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: getattr(results, name) for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())


class IncompleteError(InvalidValueError):
    """An evaluation is incomplete."""


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
        IncompleteError: if chunks are missing.
        TooLargeError: if there are more maps.
        InvalidValueError: if it is not an evaluation, or is damaged.
        UnknownNameError: if a task is not registered.
    """
    config = EvaluationConfig.load(path)
    n = config.seeds[1] - config.seeds[0]
    results: list[tuple[str, tuple[Results, ...]]] = []
    for key in config.episodes_keys():
        if task not in (None, key.task):
            continue
        if most is not None and n > most:
            raise TooLargeError(f"it has {n} maps; at most {most} are ranked here")
        get_task(key.task, key.version)
        repeats = range(config.repeats.get(f"{key.agent} on {key.task}", 1))
        chunks = [key._replace(repeat=repeat) for repeat in repeats]
        results.append((key.agent, tuple(_whole(path / CHUNKS, chunk, config.piece) for chunk in chunks)))
    return results


def _whole(folder: Path, key: EpisodesKey, size: int) -> Results:
    chunks = [_load(_file(folder, chunk), chunk) for chunk in key.chunks(size)]
    found = [chunk for chunk in chunks if chunk is not None]
    if len(found) < len(chunks):
        missing = len(chunks) - len(found)
        raise IncompleteError(f"{missing} of {len(chunks)} pieces of {key.agent} on {key.task} are not flown yet")
    return concatenate(found, key)


def shipped_results(key: EpisodesKey) -> Results | None:
    """Return the results of a key from the shipped evaluation; None if it has no chunk of exactly these maps."""
    return _load(_file(SHIPPED / CHUNKS, key), key)


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
        with NpzFile(BytesIO(_read(path)), allow_pickle=False) as archive:
            zipped: Any = archive.zip
            if archive.files != list(COLUMNS):
                raise ValueError(f"its columns are not {', '.join(COLUMNS)}")
            if zipped.testzip():
                raise ValueError("its checksums are wrong")
            columns: dict[str, Any] = {name: archive[name] for name in COLUMNS}
        task, shape = get_task(key.task, key.version), (key.seeds[1] - key.seeds[0],)
        if any(columns[name].dtype != kind or columns[name].shape != shape for name, kind in COLUMNS.items()):
            raise ValueError(f"its columns have other types or lengths than those of {shape[0]} maps")
        results = Results(key, **columns)
        valid = (
            (results.seeds == np.arange(*key.seeds))
            & (results.scores >= LOWEST)
            & (results.scores <= HIGHEST)
            & (results.steps >= 0)
            & (results.steps <= task.max_steps)
            & (results.deliveries >= 0)
            & (results.deliveries <= task.deliveries)
            & (results.success == (results.deliveries == task.deliveries))
        )
        if not valid.all():
            raise ValueError("seeds, scores, steps, deliveries or success are out of range")
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        reason = str(error).removeprefix(f"{path} ")
        raise InvalidValueError(f"{path} is damaged ({reason}): delete it, and its maps are flown again") from None
    return results
