"""The scores of the agents on the test maps of every task, and their CPU times: the tables of docs/benchmark.md.

Results are cached in results/agents, one file per task and agent, so that a stopped run continues. A new network or
version of a task or agent is flown again. If an agent changes without a new version, remove the folder.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from docs_tables import table

from drone_env.agents import AGENTS
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import UnsupportedTaskError
from drone_env.files import write_json
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.results.result import EpisodesKey
from drone_env.results.statistics import with_interval
from drone_env.results.tables import number

CACHE = Path(__file__).parents[1] / "results" / "agents"
MAPS = 1000
BEST = "optimal"
SHOWN = [*(agent for agent in AGENTS if agent != BEST), BEST]


def figures_of(task: TaskConfig) -> dict[str, dict[str, Any]]:
    """The figures of each agent that can fly a task, with `cpu_ms`, its CPU time for a map in milliseconds."""
    keys: dict[str, EpisodesKey] = {}
    for agent in SHOWN:
        try:
            keys[agent] = episodes_key(task, agent, split_seeds("test", MAPS), "test")
        except UnsupportedTaskError as error:
            print(f"no row for {agent} on {task.id}: {error}", file=sys.stderr)
    files = {agent: CACHE / f"{key.task}-v{key.version}-{agent}-{key.config_hash}.json" for agent, key in keys.items()}
    if not all(file.exists() for file in files.values()):
        CACHE.mkdir(parents=True, exist_ok=True)
        # First, and kept by `run_episodes`: the time of the others is then their own.
        for agent in (BEST, *keys):
            if agent == BEST or not files[agent].exists():
                run_episodes(episodes_key(task, agent, split_seeds("validation", 2), "validation"))  # compiles
                began = time.process_time()
                figures = summarise(run_episodes(keys[agent]))
                figures["cpu_ms"] = (time.process_time() - began) / MAPS * 1e3
                if not files[agent].exists():
                    write_json(files[agent], figures)
                    print(
                        f"{task.id} {agent}: {figures['score_ratio']:.4f}, {figures['cpu_ms']:.2f} ms", file=sys.stderr
                    )
    return {agent: json.loads(file.read_text(encoding="utf-8")) for agent, file in files.items()}


def table_of_all() -> str:
    """Return the tables of docs/benchmark.md: a row per agent, a column per task."""
    tasks = [task for task in TASKS.values() if task.terrain is None]
    figures = [figures_of(task) for task in tasks]
    cells: dict[str, Callable[[dict[str, Any]], str]] = {
        "Score (95 % interval)": lambda of: with_interval(of["mean_score"], of["score_ci95"]),
        "Ratio to the optimum, and share of flights that delivered all parcels": lambda of: (
            f"{number(of['score_ratio'])}, {of['success_rate']:.1%}"
        ),
        "CPU time of a flight in ms": lambda of: f"{of['cpu_ms']:.3g}",
    }
    parts: list[str] = []
    for title, cell in cells.items():
        rows = [[agent, *(cell(of[agent]) if agent in of else "-" for of in figures)] for agent in SHOWN]
        parts.append(f"**{title}**\n\n{table([['agent', *(task.short_name for task in tasks)], *rows])}")
    return "\n\n".join(parts)
