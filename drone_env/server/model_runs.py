"""The evaluations and the runs of language models in the data folder: which there are, and what they contain.

What flies a model again is imported where it is needed: most servers have no such run.
"""

import os
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from drone_env.errors import DroneEnvError
from drone_env.files import stamp
from drone_env.results.folder import CHUNKS, CONFIG
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, evaluation_entries

if TYPE_CHECKING:
    from drone_env.llm.config import RunConfig
    from drone_env.llm.transcript import Call

MOST_MAPS = 10_000
"""Maximum number of maps per evaluation: `random` and the optimum are flown over them while somebody waits."""
MOST_FLIGHTS = 100_000
"""Maximum number of flights read per run: a file may claim 2^53."""
Entries = list[LeaderboardEntry | NotRanked]


class _Folders:
    """Folders within one, which may be missing; the entries of each are made again only after its files change.

    Args:
        folder: The folder of the folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[Hashable, tuple[object, Entries]] = {}

    def _entries(self, key: Hashable, path: Path, files: Iterable[Path], make: Callable[[], Entries]) -> Entries:
        """The entries of a folder, which `files` decide; `key` names them here."""
        try:
            stamps = [(file, stamp(file)) for file in files]
        except OSError as error:
            return [NotRanked(path, str(error), damaged=True)]
        known = self._made.get(key)
        if known is None or known[0] != stamps:
            known = self._made[key] = stamps, make()
        return known[1]


class Evaluations(_Folders):
    """The evaluations in a folder."""

    def folders(self) -> list[Path]:
        """The folders of evaluations, by name."""
        return [path for path in sorted(self._folder.glob("*")) if os.path.lexists(path / CONFIG)]

    def entries(self, path: Path, task: str) -> Entries:
        """The entry of each agent on a task, or why it is not ranked."""
        files = (path / CONFIG, *sorted((path / CHUNKS).glob("*.npz")))
        return self._entries((path, task), path, files, lambda: evaluation_entries(path, task, MOST_MAPS))


class ModelRuns(_Folders):
    """The runs of language models in a folder."""

    def configs(self) -> "dict[Path, RunConfig | None]":
        """The configuration of each run, by its folder; None if it cannot be read."""
        found: dict[Path, RunConfig | None] = {}
        for path in sorted(self._folder.glob("*")):
            from drone_env.llm.run_folder import CONFIG, load_config

            if os.path.lexists(path / CONFIG):
                try:
                    found[path] = load_config(path)
                except (DroneEnvError, OSError):
                    found[path] = None
        return found

    def models(self) -> set[str]:
        """The models that have flown."""
        return {config.model for config in self.configs().values() if config is not None}

    def entries(self, path: Path) -> Entries:
        """The entry of a run, which is flown again first, or why it is not ranked."""
        from drone_env.llm.report import run_entry
        from drone_env.llm.run_folder import CONFIG, EPISODES, RESULTS, TRANSCRIPT

        files = [path / name for name in (CONFIG, TRANSCRIPT, EPISODES, RESULTS)]
        return self._entries(path, path, files, lambda: [run_entry(path)])

    def flights(self, path: Path) -> list[tuple[str, int]]:
        """The flights of a run that count: their ids in a store, and the seeds of their maps."""
        from drone_env.llm.run_folder import EpisodeIds, load_results

        ids = EpisodeIds(path)
        return [(ids.of(result.flight), result.seed) for result in load_results(path) if result.status != "errored"]

    def calls(self, episode_id: str) -> "tuple[Path, RunConfig, list[Call]] | None":
        """The calls of a stored flight, in order, and its run; None if no run flew it.

        Raises:
            OSError: if the transcript cannot be read.
            InvalidValueError: if the transcript of the run is damaged.
        """
        for path, config in self.configs().items():
            from drone_env.llm.run_folder import TRANSCRIPT, EpisodeIds
            from drone_env.llm.transcript import read_calls

            if config is None:
                continue
            try:
                ids = EpisodeIds(path)
            except (DroneEnvError, OSError):  # it has made no call yet, or is damaged
                continue
            for flight in range(min(config.flights, MOST_FLIGHTS)):
                if ids.of(flight) == episode_id:
                    calls = [call for _, call in read_calls(path / TRANSCRIPT) if call.flight == flight]
                    return path, config, sorted(calls, key=lambda call: call.key)
        return None
