"""The evaluations and the runs of language models in the data folder, and the shipped evaluation.

Modules that fly a model again are imported lazily: most servers have no such run.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drone_env.agents import file_of, rebase_agent_path
from drone_env.errors import DroneEnvError
from drone_env.files import EVALUATIONS, RUNS, file_identity
from drone_env.results.folder import CONFIG, SHIPPED, EvaluationConfig
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, evaluation_entries

if TYPE_CHECKING:
    from drone_env.llm.config import RunConfig
    from drone_env.llm.transcript import Call

MOST_MAPS = 10_000
"""Maximum number of maps per evaluation: the server flies `random` and the optimum over them during a request."""
Entries = list[LeaderboardEntry | NotRanked]


def run_configs(data: Path) -> "dict[Path, RunConfig | None]":
    """The configuration of each run of a model, by its folder; None if it cannot be read."""
    found: dict[Path, RunConfig | None] = {}
    for path in sorted((data / RUNS).glob("*")):
        from drone_env.llm.run_folder import CONFIG, load_config

        if os.path.lexists(path / CONFIG):
            try:
                found[path] = load_config(path)
            except (DroneEnvError, OSError):
                found[path] = None
    return found


def result_folders(data: Path, task: str) -> list[Path]:
    """The folders that may have results of a task: the shipped one, runs of models, and evaluations, by name."""
    runs = [path for path, config in run_configs(data).items() if config is None or config.task == task]
    evaluations = [path for path in sorted((data / EVALUATIONS).glob("*")) if os.path.lexists(path / CONFIG)]
    return [SHIPPED, *runs, *evaluations]


def identity_of(path: Path) -> object:
    """A value that changes when a file of a folder changes."""
    return [(file, file_identity(file)) for file in sorted(path.rglob("*"))]


def folder_entries(path: Path, task: str) -> Entries:
    """The leaderboard entries of a folder for a task, or why it is not ranked: a job of a worker process.

    Results have one row per map. Those of a model contain the ids that its flights have if they are stored. Paths of
    the server are left out.
    """
    if path.parent.name != RUNS:
        entries = evaluation_entries(path, task, MOST_MAPS)
    else:
        from drone_env.llm.report import run_entry

        entries = [run_entry(path)]
    return [_shown(entry) for entry in entries]


def _shown(entry: LeaderboardEntry | NotRanked) -> LeaderboardEntry | NotRanked:
    if isinstance(entry, NotRanked):
        return entry._replace(reason=entry.reason.replace(str(entry.path), entry.path.name))
    results, agent = entry.results.by_map(), entry.agent
    file = file_of(agent)
    if file is not None and file.is_absolute():
        agent = rebase_agent_path(agent, Path(file.name))
    if entry.report:
        newest = dict(zip(entry.results.seeds.tolist(), entry.results.ids, strict=True))
        results = replace(results, ids=[newest[seed] for seed in results.seeds.tolist()])
    return replace(entry, results=replace(results, key=results.key._replace(agent=agent)))


def run_name(path: Path) -> str:
    """The name of a folder's run: that of the folder, or the version of this package that flew the shipped results."""
    return f"drone-env {EvaluationConfig.load(SHIPPED).package}" if path == SHIPPED else path.name


def model_calls(data: Path, episode_id: str) -> "tuple[str | None, list[Call]]":
    """The language model of a stored flight and its calls in order: a job of a worker process.

    None and no calls if no run flew it, or the run is damaged, which the leaderboard reports.
    """
    for path, config in run_configs(data).items():
        from drone_env.llm.run_folder import TRANSCRIPT, EpisodeIds
        from drone_env.llm.transcript import read_calls

        try:
            ids = EpisodeIds(path)
            for flight in range(0 if config is None else config.flights):
                if config is not None and ids.of(flight) == episode_id:
                    calls = [call for call in read_calls(path / TRANSCRIPT) if call.flight == flight]
                    return config.model, sorted(calls, key=lambda call: call.key)
        except (DroneEnvError, OSError):
            continue
    return None, []
