"""Evaluation on any engine: an engine is a map over keys, and a folder keeps what it has brought so far."""

import json
import os
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drone_env import __version__
from drone_env.core.tasks import WITHDRAWN, withdrawal
from drone_env.errors import InvalidValueError
from drone_env.evaluation.episodes import (
    COLUMNS,
    PIECE,
    EpisodeResults,
    EpisodesKey,
    concatenate,
    pieces_of,
    run_episodes,
)
from drone_env.files import differences, is_begun, replacing, write_json

Engine = Callable[[Sequence[EpisodesKey]], Iterator[EpisodeResults]]
"""Brings the results of all keys, in any order; bringing one twice does no harm."""
CONFIG, PIECES = "evaluation.json", "pieces"


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
            write_json(config_path, config)
        self._pieces.mkdir(exist_ok=True)

    def load(self, key: EpisodesKey) -> EpisodeResults | None:
        """The results of a piece, None where it has not been flown yet.

        Raises:
            OSError: if the file cannot be read.
            InvalidValueError: if it is damaged.
        """
        path = self._path(key)
        if not path.exists():
            return None
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                results = EpisodeResults(key=key, **{name: file[name] for name in COLUMNS})
            whole = np.array_equal(results.seeds, np.arange(*key.seeds))
            if not whole or any(len(getattr(results, name)) != len(results.seeds) for name in COLUMNS):
                raise ValueError("it holds other episodes")
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise InvalidValueError(f"{path} is damaged, remove it to have it flown again: {error}") from None
        return results

    def save(self, results: EpisodeResults) -> None:
        """Keep the results of a piece.

        Raises:
            OSError: if they cannot be written.
        """
        with replacing(self._path(results.key)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **{name: getattr(results, name) for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())

    def _path(self, key: EpisodesKey) -> Path:
        return self._pieces / f"{key.task}-v{key.version}-{key.config_hash}-{key.seeds[0]}-{key.seeds[1]}.npz"


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


def _config(keys: Sequence[EpisodesKey]) -> dict[str, Any]:
    """What decides the results, as JSON. A network's file is named by what it holds, not by where it lies."""
    first = keys[0]
    return {
        "format": "drone_env/evaluation",
        "format_version": 1,
        "package": __version__,
        "piece": PIECE,
        "split": first.split,
        "seeds": list(first.seeds),
        "tasks": sorted({f"{key.task} v{key.version}" for key in keys}),
        "agents": {f"{key.agent.partition(':')[0]} on {key.task}": key.config_hash for key in keys},
    }


def _begun_by(path: Path, config: dict[str, Any]) -> str:
    """The version of this package that began the evaluation; an evaluation that is not whole must be of this one."""
    try:
        before: Any = json.loads(path.read_bytes())
        if not isinstance(before, dict) or before.get("format") != config["format"]:
            raise ValueError("it has another format")
    except ValueError as error:
        raise InvalidValueError(f"{path} is not the configuration of an evaluation: {error}") from None
    changed = differences({**before, "package": ""}, {**config, "package": ""})
    if changed:
        gone = [f"{withdrawal(*pair)}" for pair in WITHDRAWN if "{} v{}".format(*pair) in before.get("tasks", ())]
        raise InvalidValueError(f"{path.parent} holds another evaluation: {'; '.join(changed + gone)}")
    return f"{before.get('package')}"
