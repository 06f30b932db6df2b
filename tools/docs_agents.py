"""What the agents reach on the test maps of every task, and what it costs them: the table of docs/benchmark.md.

What was flown is kept in results/agents, a file for each task and agent, so that a stopped run goes on; another network
or another version of a task or agent is flown anew. Whoever changes how an agent flies without a new version removes
the folder.
"""

import json
import sys
import time
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

KEPT = Path(__file__).parents[1] / "results" / "agents"
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
    files = {agent: KEPT / f"{key.task}-v{key.version}-{agent}-{key.config_hash}.json" for agent, key in keys.items()}
    if not all(file.exists() for file in files.values()):
        KEPT.mkdir(parents=True, exist_ok=True)
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
    """How the agents fly all tasks: the table of docs/benchmark.md."""
    head = [
        "task", "agent", "score (95 %)", "ratio", "delivered all", "excess steps", "CPU ms",
    ]  # fmt: skip
    rows = [head]
    for task in (one for one in TASKS.values() if one.terrain is None):
        for agent, of in figures_of(task).items():
            score = [with_interval(of["mean_score"], of["score_ci95"]), number(of["score_ratio"])]
            steps = [f"{of['success_rate']:.1%}", number(of["mean_excess_steps"], ".2f"), f"{of['cpu_ms']:.3g}"]
            rows.append([task.id, agent, *score, *steps])
    return table(rows)
