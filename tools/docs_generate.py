"""Write the parts of the documentation that take minutes to compute.

    tasks   docs/images/<task>.png, preview.png of the page, and the scores in docs/benchmark.md
    audits  docs/reward.md: the table of audits
    curves  docs/reward.md and docs/images/training/*.png: training on `tiered` and on `aligned`

`python tools/docs_generate.py tasks curves` writes these alone; without a name, tasks and audits. Curves need PyTorch.
"""

import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from docs_tables import put, table

from drone_env.agents import AGENTS
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.envs.rendering import save_picture
from drone_env.errors import UnsupportedTaskError
from drone_env.planning.audit import audit_maps, audited_profile, summarise_audits
from drone_env.planning.optimal import solve
from drone_env.results.evaluate import evaluate, summarise
from drone_env.results.statistics import with_interval
from drone_env.results.tables import number
from drone_env.server.page_files import PAGE

DOCS = Path(__file__).parents[1] / "docs"
BENCHMARK, REWARD = DOCS / "benchmark.md", DOCS / "reward.md"
MAPS = 1000
"""Test maps of each task in docs/benchmark.md."""
BEST = "optimal"
AUDITED = {"easy_delivery": 1000, "hard_delivery": 40, "skyline_easy": 200}
"""How many test maps the audits of a task run over."""
CURVES, CURVES_EPISODES = "easy", 1_500
"""The task of the curves, and how many episodes are enough to see which way each goes."""


def picture(task: TaskConfig, seed: int, file: Path, pixels: int) -> None:
    """Draw a best flight over a map."""
    save_picture(Episode(task, seed=seed).fly(solve(task, seed).actions), file, pixels)


def figures_of(task: TaskConfig) -> dict[str, dict[str, Any]]:
    """The figures of each agent that supports a task."""
    figures: dict[str, dict[str, Any]] = {}
    for agent in AGENTS:
        with suppress(UnsupportedTaskError):
            figures[agent] = summarise(evaluate(agent, task, "test", MAPS))
            print(f"{task.id} {agent}: {figures[agent]['score_ratio']:.4f}", file=sys.stderr)
    return figures


def agents_tables(tasks: list[TaskConfig]) -> str:
    """The tables of docs/benchmark.md: a row per agent, a column per task."""
    figures = [figures_of(task) for task in tasks]
    cells: dict[str, Callable[[dict[str, Any]], str]] = {
        "Score (95 % interval)": lambda of: with_interval(of["mean_score"], of["score_ci95"]),
        "Ratio to the optimum, and share of flights that delivered all parcels": lambda of: (
            f"{number(of['score_ratio'])}, {of['success_rate']:.1%}"
        ),
    }
    parts: list[str] = []
    for title, cell in cells.items():
        rows = [["agent", *(task.short_name for task in tasks)]]
        for agent in (*(agent for agent in AGENTS if agent != BEST), BEST):
            rows.append([agent, *(cell(of[agent]) if agent in of else "-" for of in figures)])
        parts.append(f"**{title}**\n\n{table(rows)}")
    return "\n\n".join(parts)


def write_tasks() -> None:
    """Draw a best flight of every task, and write the tables of docs/benchmark.md."""
    for task in TASKS.values():
        picture(task, split_seeds("test", 1)[0], DOCS / "images" / f"{task.id}.png", 480)
    picture(TASKS["skyline_medium"], 43, PAGE / "preview.png", 630)
    write_agents("agents", "standard", "skyline")
    write_agents("agents on rush", "rush")


def write_agents(name: str, *families: str) -> None:
    """Write the tables of these families in docs/benchmark.md."""
    text = agents_tables([task for task in TASKS.values() if task.family in families])
    BENCHMARK.write_text(put(BENCHMARK.read_text(encoding="utf-8"), name, text), encoding="utf-8")


def audits(task: TaskConfig, maps: int) -> list[str]:
    """The rows of a task in the table of audits."""
    rows: list[str] = []
    cases = [(name, 1.0, None) for name in REWARD_PROFILES]
    cases += [("aligned", 0.99, None), ("score", 0.99, None), ("aligned", 1.0, 0.99)]
    for name, gamma, shaping_gamma in cases:
        profile = audited_profile(name, gamma, shaping_gamma)
        report = summarise_audits(
            task, profile, gamma, list(audit_maps(task, split_seeds("test", maps), profile, gamma))
        )
        mean = report["mean_returns"]
        first = f"{task.short_name}: {maps} maps, optimum {report['mean_optimal_score']:.3f}" if not rows else ""
        note = f" (shaping {shaping_gamma})" if shaping_gamma is not None else ""
        bold = "" if report["verdict"] == "aligned" else "**"
        rows.append(
            f"| {first} | `{name}`{note} | {gamma:g} | {bold}{report['share_aligned']:.1%}{bold} "
            f"| {report['mean_score']:.3f} | {mean['honest']:.2f} | {mean['hover']:.2f} |"
        )
        print(rows[-1], file=sys.stderr)
    return rows


def write_audits() -> None:
    """Write the table of audits in docs/reward.md."""
    lines = [
        "| task | reward | gamma | maps on which it reaches the optimum | score of the maximiser "
        "| return: honest | hover |",
        "|---|---|---|---|---|---|---|",
    ]
    for task_id, maps in AUDITED.items():
        lines += audits(TASKS[task_id], maps)
    REWARD.write_text(put(REWARD.read_text(encoding="utf-8"), "audits", "\n".join(lines)), encoding="utf-8")


def write_curves() -> None:
    """Train on two rewards, draw the curves, and write their table in docs/reward.md."""
    from matplotlib import pyplot

    from drone_env.rl.config import preset
    from drone_env.rl.trainer import Progress, Trainer

    histories: dict[str, list[Progress]] = {}
    rows = [
        ["trained on", "reward of the last episodes", "steps", "delivered", "its score on validation maps", "optimum"]
    ]
    for reward in ("tiered", "aligned"):
        trainer = Trainer(replace(preset("fast", CURVES), reward_profile=reward, episodes=CURVES_EPISODES))
        for _ in trainer.train():
            pass
        last = trainer.history[-1]
        histories[reward] = trainer.history
        shares = [f"{last.success:.1%}", f"{last.validation:.4f}", f"{last.validation_optimum:.4f}"]
        rows.append([f"`{reward}`", f"{last.reward:.2f}", f"{last.length:.1f}", *shares])
        print(rows[-1], file=sys.stderr)
    for name in ("reward", "length", "loss", "epsilon", "validation"):
        pyplot.figure(figsize=(7, 4), layout="constrained")
        for reward, history in histories.items():
            pyplot.plot([line.episode for line in history], [getattr(line, name) for line in history], label=reward)
        pyplot.xlabel("episodes")
        pyplot.ylabel(name)
        pyplot.legend()
        pyplot.savefig(DOCS / "images" / "training" / f"{name}.png", dpi=120)
    REWARD.write_text(put(REWARD.read_text(encoding="utf-8"), "curves", table(rows)), encoding="utf-8")


if __name__ == "__main__":
    parts = {"tasks": write_tasks, "audits": write_audits, "curves": write_curves}
    for name in sys.argv[1:] or ["tasks", "audits"]:
        parts[name]()
