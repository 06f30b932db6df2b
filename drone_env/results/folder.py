"""The folder of an evaluation: its configuration, and one file per piece of its results."""

import os
import zlib
from collections.abc import Sequence
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
from drone_env.errors import InvalidValueError, TooLargeError, shown
from drone_env.files import differences, is_begun, read_file, replacing, write_json
from drone_env.models import Message
from drone_env.results.result import COLUMNS, PIECE, EpisodesKey, Results, concatenate

CONFIG, PIECES = "evaluation.json", "pieces"
MOST_BYTES = 1 << 20
"""Bytes of a configuration, and of a piece: 1,000 episodes take 38,000."""
MOST_PIECES = 1_000_000
Name = Annotated[str, Field(max_length=1000)]


class EvaluationConfig(Message):
    """What decides the results of an evaluation. A network's file is named by its digest, not by its path."""

    format: Literal["drone_env/evaluation"] = "drone_env/evaluation"
    format_version: Literal[1] = 1
    package: Name
    piece: int = Field(ge=1, le=MOST_PIECES)
    split: Name
    seeds: list[Annotated[int, Field(ge=0, le=N_SEEDS)]] = Field(min_length=2, max_length=2)
    repeats: dict[Name, Annotated[int, Field(ge=2, le=MOST_PIECES)]] = Field(default_factory=dict)
    tasks: list[Annotated[Name, Field(pattern="^.+ v[0-9]{1,9}$")]]
    agents: dict[Name, Annotated[str, Field(pattern="^[0-9a-f]{16}$")]]

    @classmethod
    def of(cls, keys: Sequence[EpisodesKey]) -> Self:
        """The configuration of an evaluation of all keys."""
        first, labels = keys[0], {key: f"{(network_file(key.agent) or [key.agent])[0]} on {key.task}" for key in keys}
        return cls(
            package=__version__,
            piece=PIECE,
            split=first.split,
            seeds=list(first.seeds),
            repeats={label: key.repeat + 1 for key, label in labels.items() if key.repeat},
            tasks=sorted({f"{key.task} v{key.version}" for key in keys}),
            agents={label: key.config_hash for key, label in labels.items()},
        )

    @classmethod
    def load(cls, folder: Path) -> Self:
        """The configuration in a folder.

        Raises:
            OSError: if it cannot be read.
            InvalidValueError: if it is not the configuration of an evaluation.
        """
        path = folder / CONFIG
        return cls.read(read_file(path, MOST_BYTES), f"{path} is not the configuration of an evaluation")

    @model_validator(mode="after")
    def _flyable(self) -> Self:
        start, stop = self.seeds
        if not 0 < stop - start <= MOST_PIECES * self.piece:
            raise ValueError(f"seeds {start}:{stop} are not 1 to {MOST_PIECES:,} pieces of {self.piece} maps")
        versions = self.versions()
        for label in self.agents:
            if label.rpartition(" on ")[2] not in versions:
                raise ValueError(f"agents: {shown(label)} does not end in ' on TASK', with a task of `tasks`")
        return self

    def versions(self) -> dict[str, int]:
        """The version of each task by its id."""
        named = [task.rpartition(" v") for task in self.tasks]
        return {task: int(version) for task, _, version in named}


class ResultsFolder:
    """The results of an evaluation, piece by piece; a stopped evaluation continues from there.

    A piece is one file, whole or not at all, named by its key.

    Args:
        path: The folder; it is created if it is missing.
        keys: What is evaluated.

    Raises:
        OSError: if it cannot be made or read.
        InvalidValueError: if it holds another evaluation, one of another version of this package, or anything else;
            the message says what differs.
    """

    def __init__(self, path: Path, keys: Sequence[EpisodesKey]) -> None:
        self._pieces, config = path / PIECES, EvaluationConfig.of(keys)
        if is_begun(path, CONFIG, "an evaluation"):
            changed = differences(EvaluationConfig.load(path).model_dump(), config.model_dump())
            if changed:
                raise InvalidValueError(f"{path} holds another evaluation: {'; '.join(changed)}")
        else:
            path.mkdir(parents=True, exist_ok=True)
            write_json(path / CONFIG, config.model_dump())
        self._pieces.mkdir(exist_ok=True)

    def load(self, key: EpisodesKey) -> Results | None:
        """The results of a piece; None if it has not been flown yet.

        Raises:
            OSError: if the file cannot be read.
            InvalidValueError: if it is damaged.
        """
        return _load(_file(self._pieces, key), key)

    def save(self, results: Results) -> None:
        """Store the results of a piece.

        Raises:
            OSError: if they cannot be written.
        """
        with replacing(_file(self._pieces, results.key)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: getattr(results, name) for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())


class NotWholeError(InvalidValueError):
    """An evaluation that has not been flown to its end."""


def stored_results(
    path: Path, task: str | None = None, most: int | None = None
) -> list[tuple[str, tuple[Results, ...]]]:
    """The results in the folder of a complete evaluation: for each agent and task its name and its repeats.

    Args:
        path: The folder.
        task: Leave out other tasks than this one.
        most: Read at most so many maps.

    Raises:
        OSError: if it cannot be read.
        NotWholeError: if pieces are missing.
        TooLargeError: if there are more maps.
        InvalidValueError: if there is no evaluation, or it is damaged.
        UnknownNameError: if it is of a task that does not exist, or no longer.
    """
    config = EvaluationConfig.load(path)
    versions, (start, stop) = config.versions(), config.seeds
    flown: list[tuple[str, tuple[Results, ...]]] = []
    for label, digest in config.agents.items():
        agent, _, of_task = label.rpartition(" on ")
        if task not in (None, of_task):
            continue
        if most is not None and stop - start > most:
            raise TooLargeError(f"{stop - start} maps are more than the {most} that are looked at here")
        get_task(of_task, versions[of_task])
        key = EpisodesKey(of_task, versions[of_task], config.split, (start, stop), agent, digest)
        repeats = [key._replace(repeat=repeat) for repeat in range(config.repeats.get(label, 1))]
        flown.append((agent, tuple(_whole(path / PIECES, of, config.piece) for of in repeats)))
    return flown


def _whole(pieces: Path, key: EpisodesKey, size: int) -> Results:
    parts = [_load(_file(pieces, part), part) for part in key.pieces(size)]
    missing = sum(part is None for part in parts)
    if missing:
        raise NotWholeError(f"{missing} of {len(parts)} pieces of {key.agent} on {key.task} are not flown yet")
    return concatenate([part for part in parts if part is not None])


def _file(pieces: Path, key: EpisodesKey) -> Path:
    again = f"-again{key.repeat}" if key.repeat else ""
    return pieces / f"{key.task}-v{key.version}-{key.config_hash}-{key.seeds[0]}-{key.seeds[1]}{again}.npz"


def _columns(content: bytes) -> dict[str, Any]:
    with NpzFile(BytesIO(content), allow_pickle=False) as archive:
        zipped: Any = archive.zip
        # Checked first: an entry that is packed may be many times as large as the file.
        if sum(entry.file_size for entry in zipped.infolist()) > MOST_BYTES:
            raise ValueError(f"unpacked it would have more than {MOST_BYTES} bytes")
        if zipped.testzip():
            raise ValueError("a checksum is wrong")
        if archive.files != list(COLUMNS):
            raise ValueError(f"it holds {shown(archive.files)} instead of {', '.join(COLUMNS)}")
        return {name: archive[name] for name in COLUMNS}


def _load(path: Path, key: EpisodesKey) -> Results | None:
    if not path.exists():
        return None
    try:
        columns = _columns(read_file(path, MOST_BYTES))
        for name, kind in COLUMNS.items():
            column = columns[name]
            if column.dtype != kind or column.shape != (key.seeds[1] - key.seeds[0],):
                raise ValueError(f"{name} is {shown(column.dtype)}{list(column.shape)}")
        results = Results(key=key, **columns)
        if not np.array_equal(results.seeds, np.arange(*key.seeds)):
            raise ValueError("it holds other episodes")
        task = get_task(key.task, key.version)
        # NaN compares as False.
        scores = ((results.scores >= LOWEST) & (results.scores <= HIGHEST)).all()
        steps = ((results.steps >= 0) & (results.steps <= task.max_steps)).all()
        done = ((results.deliveries >= 0) & (results.deliveries <= task.deliveries)).all()
        if not (scores and steps and done and (results.success == (results.deliveries == task.deliveries)).all()):
            raise ValueError("scores, steps, deliveries or success are out of range")
    except (ValueError, KeyError, EOFError, RuntimeError, BadZipFile, zlib.error) as error:
        why = str(error).removeprefix(f"{path} ")
        raise InvalidValueError(f"{path} is damaged, remove it to have it flown again: {why}") from None
    return results
