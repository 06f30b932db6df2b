"""Evaluation on any engine: an engine is a map over keys, and a folder keeps what it has brought so far."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drone_env import __version__
from drone_env.agents import network_file
from drone_env.core.score import HIGHEST, LOWEST
from drone_env.core.tasks import WITHDRAWN, get_task, withdrawal
from drone_env.errors import InvalidValueError, TooLargeError, shown
from drone_env.files import differences, is_begun, read_file, replacing, write_json
from drone_env.npz import unpack_arrays
from drone_env.results.evaluate import (
    COLUMNS,
    PIECE,
    EpisodeResults,
    EpisodesKey,
    concatenate,
    pieces_of,
    run_episodes,
)

if TYPE_CHECKING:
    from drone_env.results.config import EvaluationConfig

Engine = Callable[[Sequence[EpisodesKey]], Iterator[EpisodeResults]]
"""Brings the results of all keys, in any order; bringing one twice does no harm."""
CONFIG, PIECES = "evaluation.json", "pieces"
MOST_BYTES = 1 << 20
"""Bytes of a configuration, and of a piece: 1,000 episodes take 38,000."""


def local_engine(keys: Sequence[EpisodesKey]) -> Iterator[EpisodeResults]:
    """One after another, in this process."""
    return map(run_episodes, keys)


class ResultsFolder:
    """The results of an evaluation, piece by piece; one that was stopped goes on from there.

    A piece is one file, whole or not at all, named by its key.

    Args:
        path: Made where it is missing.
        keys: What is evaluated.

    Raises:
        OSError: if it cannot be made or read.
        InvalidValueError: if it holds another evaluation, or anything else; the message says what differs.

    Attributes:
        package: The version of this package that began it, and alone goes on with it; any later one shows it if whole.
    """

    def __init__(self, path: Path, keys: Sequence[EpisodesKey]) -> None:
        self._pieces = path / PIECES
        config_path, config = path / CONFIG, _config(keys)
        self.package: str = __version__
        if is_begun(path, CONFIG, "an evaluation"):
            self.package = _begun_by(config_path, config)
        else:
            path.mkdir(parents=True, exist_ok=True)
            write_json(config_path, config.model_dump())
        self._pieces.mkdir(exist_ok=True)

    def load(self, key: EpisodesKey) -> EpisodeResults | None:
        """The results of a piece, None where it has not been flown yet.

        Raises:
            OSError: if the file cannot be read.
            InvalidValueError: if it is damaged.
        """
        return _load(_file(self._pieces, key), key)

    def save(self, results: EpisodeResults) -> None:
        """Keep the results of a piece.

        Raises:
            OSError: if they cannot be written.
        """
        with replacing(_file(self._pieces, results.key)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: getattr(results, name) for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())


def _file(pieces: Path, key: EpisodesKey) -> Path:
    again = f"-again{key.repeat}" if key.repeat else ""
    return pieces / f"{key.task}-v{key.version}-{key.config_hash}-{key.seeds[0]}-{key.seeds[1]}{again}.npz"


def _load(path: Path, key: EpisodesKey) -> EpisodeResults | None:
    if not path.exists():
        return None
    try:
        columns = unpack_arrays(read_file(path, MOST_BYTES), MOST_BYTES)
        if columns.keys() != COLUMNS.keys():
            raise ValueError(f"it holds {shown(sorted(columns))} instead of {', '.join(COLUMNS)}")
        for name, kind in COLUMNS.items():
            column = columns[name]
            if column.dtype != kind or column.shape != (key.seeds[1] - key.seeds[0],):
                raise ValueError(f"{name} is {shown(column.dtype)}{list(column.shape)}")
        results = EpisodeResults(key=key, **columns)
        if not np.array_equal(results.seeds, np.arange(*key.seeds)):
            raise ValueError("it holds other episodes")
        task = get_task(key.task, key.version)
        # NaN compares as False.
        scores = ((results.scores >= LOWEST) & (results.scores <= HIGHEST)).all()
        steps = ((results.steps >= 0) & (results.steps <= task.max_steps)).all()
        done = ((results.deliveries >= 0) & (results.deliveries <= task.deliveries)).all()
        if not (scores and steps and done and (results.success == (results.deliveries == task.deliveries)).all()):
            raise ValueError("scores, steps, deliveries or success are out of range")
    except ValueError as error:
        why = str(error).removeprefix(f"{path} ")
        raise InvalidValueError(f"{path} is damaged, remove it to have it flown again: {why}") from None
    return results


class NotWholeError(InvalidValueError):
    """An evaluation that has not been flown to its end."""


def kept_results(
    path: Path, task: str | None = None, most: int | None = None
) -> list[tuple[str, tuple[EpisodeResults, ...]]]:
    """What a folder holds of a whole evaluation: for each agent and task its name and its results, with their repeats.

    Args:
        path: The folder.
        task: Leave other tasks than this one out.
        most: Read no more maps than these.

    Raises:
        OSError: if it cannot be read.
        NotWholeError: if pieces are missing.
        TooLargeError: if there are more maps.
        InvalidValueError: if it is none, or damaged.
        UnknownNameError: if it is of a task that does not exist, or no longer.
    """
    config = _read_config(path / CONFIG)
    versions, (start, stop) = config.versions(), config.seeds
    flown: list[tuple[str, tuple[EpisodeResults, ...]]] = []
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


def _whole(pieces: Path, key: EpisodesKey, size: int) -> EpisodeResults:
    parts = [_load(_file(pieces, part), part) for part in pieces_of(key, size)]
    missing = sum(part is None for part in parts)
    if missing:
        raise NotWholeError(f"{missing} of {len(parts)} pieces of {key.agent} on {key.task} are not flown yet")
    return concatenate([part for part in parts if part is not None])


def evaluate_keys(
    keys: Sequence[EpisodesKey],
    engine: Engine,
    folder: ResultsFolder | None = None,
    arrived: Callable[[EpisodeResults], None] | None = None,
) -> dict[EpisodesKey, EpisodeResults]:
    """The results of each key: what the folder has, and the rest from the engine.

    They are put together in the order of the seeds, so that they are the same in any order of arrival.

    Args:
        keys: What to fly.
        engine: Who flies it.
        folder: Where each piece is kept before it counts.
        arrived: Called once with each piece.

    Raises:
        OSError, InvalidValueError: from the folder; the latter, too, if another version of this package began it and
            pieces are missing.
        ClusterError: from an engine on a cluster.
    """
    pieces = {key: pieces_of(key) for key in keys}
    flown: dict[EpisodesKey, EpisodeResults] = {}

    def count(results: EpisodeResults) -> None:
        flown[results.key] = results
        if arrived is not None:
            arrived(results)

    missing: list[EpisodesKey] = []
    for piece in (piece for of_key in pieces.values() for piece in of_key):
        kept = None if folder is None else folder.load(piece)
        if kept is None:
            missing.append(piece)
        else:
            count(kept)
    if missing:
        if folder is not None and folder.package != __version__:
            raise InvalidValueError(
                f"{len(missing)} of {sum(map(len, pieces.values()))} pieces are missing in the folder, and only the "
                f"drone-env that began it goes on with it: {folder.package}, this is {__version__}"
            )
        for results in engine(missing):
            if results.key in flown:
                continue
            if folder is not None:
                folder.save(results)
            count(results)
    return {key: concatenate([flown[piece] for piece in of_key]) for key, of_key in pieces.items()}


def _config(keys: Sequence[EpisodesKey]) -> "EvaluationConfig":
    from drone_env.results.config import EvaluationConfig  # loads Pydantic, which most commands do without

    first = keys[0]
    return EvaluationConfig(
        package=__version__,
        piece=PIECE,
        split=first.split,
        seeds=list(first.seeds),
        repeats={f"{_label(key)} on {key.task}": key.repeat + 1 for key in keys if key.repeat},
        tasks=sorted({f"{key.task} v{key.version}" for key in keys}),
        agents={f"{_label(key)} on {key.task}": key.config_hash for key in keys},
    )


def _label(key: EpisodesKey) -> str:
    network = network_file(key.agent)
    return key.agent if network is None else network[0]


def _read_config(path: Path) -> "EvaluationConfig":
    from drone_env.results.config import EvaluationConfig  # as above

    return EvaluationConfig.read(read_file(path, MOST_BYTES), f"{path} is not the configuration of an evaluation")


def _begun_by(path: Path, config: "EvaluationConfig") -> str:
    """The version of this package that began the evaluation; an evaluation that is not whole must be of this one."""
    before = _read_config(path)
    changed = differences(before.model_dump(exclude={"package"}), config.model_dump(exclude={"package"}))
    if changed:
        gone = [f"{withdrawal(*pair)}" for pair in WITHDRAWN if "{} v{}".format(*pair) in before.tasks]
        raise InvalidValueError(f"{path.parent} holds another evaluation: {'; '.join(changed + gone)}")
    return before.package
