"""The evaluations and the runs of language models in the data folder, and the shipped evaluation.

Modules that fly a model again are imported lazily: most servers have no such run.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drone_env.agents import file_of, rebase_agent_path
from drone_env.errors import DroneEnvError, UnknownNameError
from drone_env.files import EVALUATIONS, RUNS, file_identity
from drone_env.results.folder import CHUNKS, CONFIG, SHIPPED, EvaluationConfig
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, evaluation_entries
from drone_env.results.result import Results

if TYPE_CHECKING:
    from drone_env.llm.config import RunConfig
    from drone_env.llm.transcript import Call

MOST_MAPS = 10_000
"""Maximum number of maps per evaluation: the server flies `random` and the optimum over them during a request."""
MOST_FLIGHTS = 100_000
"""Maximum number of flights read per run: a file may claim 2^53."""
Entries = list[LeaderboardEntry | NotRanked]


class StoredRuns:
    """The evaluations and runs of language models in a data folder.

    Args:
        data: The data folder.
    """

    def __init__(self, data: Path) -> None:
        self._runs, self._evaluations = data / RUNS, data / EVALUATIONS
        self._cache: dict[tuple[Path, str], tuple[object, Entries]] = {}

    def configs(self) -> "dict[Path, RunConfig | None]":
        """The configuration of each run of a model, by its folder; None if it cannot be read."""
        found: dict[Path, RunConfig | None] = {}
        for path in sorted(self._runs.glob("*")):
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

    def folders(self, task: str) -> list[Path]:
        """The folders that may have entries for a task: the shipped one, runs of models, and evaluations, by name."""
        runs = [path for path, config in self.configs().items() if config is None or config.task == task]
        evaluations = [path for path in sorted(self._evaluations.glob("*")) if os.path.lexists(path / CONFIG)]
        return [SHIPPED, *runs, *evaluations]

    def results(self, task: str, run: str) -> dict[str, Results]:
        """The results of a run or an evaluation by agent, one row per map, with the ids that its flights would have.

        Raises:
            UnknownNameError: if there is none of this name, or it is not ranked.
        """
        found: dict[str, Results] = {}
        for path in (path for path in self.folders(task) if run_name(path) == run):
            for entry in self.entries(path, task):
                if isinstance(entry, LeaderboardEntry):
                    results = entry.results.by_map()
                    newest = {} if is_agent(entry) else {seed: id_ for id_, seed in self.flights(path)}
                    ids = [newest.get(seed) for seed in results.seeds.tolist()]
                    found[shown_agent(entry.agent)] = replace(results, ids=ids)
        if not found:
            raise UnknownNameError("run", run, [run_name(path) for path in self.folders(task)])
        return found

    def entries(self, path: Path, task: str) -> Entries:
        """The leaderboard entries of a folder for a task, or why it is not ranked. Cached until a file changes."""
        files, compute = self._sources(path, task)
        try:
            stamps = [(file, file_identity(file)) for file in files]
        except OSError as error:
            return [NotRanked(path, str(error), damaged=True)]
        cached = self._cache.get((path, task))
        if cached is None or cached[0] != stamps:
            cached = self._cache[path, task] = stamps, compute()
        return cached[1]

    def flights(self, path: Path) -> list[tuple[str, int]]:
        """The ids in the store and the seeds of a run's flights, without those that errored."""
        from drone_env.llm.run_folder import EpisodeIds, load_results

        ids = EpisodeIds(path)
        return [(ids.of(result.flight), result.seed) for result in load_results(path) if result.status != "errored"]

    def calls(self, episode_id: str) -> "tuple[Path, RunConfig, list[Call]] | None":
        """The run of a stored flight and the calls of that flight in order; None if no run flew it.

        Raises:
            OSError: if the transcript cannot be read.
            InvalidValueError: if the transcript is damaged.
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
                    calls = [call for call in read_calls(path / TRANSCRIPT) if call.flight == flight]
                    return path, config, sorted(calls, key=lambda call: call.key)
        return None

    def _sources(self, path: Path, task: str) -> tuple[Sequence[Path], Callable[[], Entries]]:
        """The files that decide the entries of a folder, and the function that computes them."""
        if path == SHIPPED:
            return [SHIPPED], partial(evaluation_entries, SHIPPED, task)
        if path.parent == self._evaluations:
            files = [path / CONFIG, *sorted((path / CHUNKS).glob("*.npz"))]
            return files, partial(evaluation_entries, path, task, MOST_MAPS)
        from drone_env.llm.report import run_entry
        from drone_env.llm.run_folder import CONFIG as RUN_CONFIG
        from drone_env.llm.run_folder import EPISODES, RESULTS, TRANSCRIPT

        return [path / name for name in (RUN_CONFIG, TRANSCRIPT, EPISODES, RESULTS)], lambda: [run_entry(path)]


def run_name(path: Path) -> str:
    """The name of a folder's run: that of the folder, or the version of this package that flew the shipped results."""
    return f"drone-env {EvaluationConfig.load(SHIPPED).package}" if path == SHIPPED else path.name


def is_agent(entry: LeaderboardEntry) -> bool:
    """Whether an agent flew, not a language model."""
    return "agent" in entry.report


def shown_agent(agent: str) -> str:
    """The name of an agent without the folder of its network's file, or of a language model."""
    file = file_of(agent)
    return agent if file is None or not file.is_absolute() else rebase_agent_path(agent, Path(file.name))
