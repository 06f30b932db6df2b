"""Write the generated parts of the documentation: `make docs-data`, some minutes.

    docs/tasks.md           every task: its numbers, a picture, and how the agents fly it
    docs/images/<task>.png  a best flight over its first test map
    docs/reward.md          the table of audits between its two markers

`python tools/docs_generate.py --tasks` leaves the audits out.
"""

import sys
from pathlib import Path

from docs_tables import between, numbers

from drone_env.agents.pathqnet import shipped_network
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.envs.rendering import save_picture
from drone_env.evaluation.episodes import episodes_key, run_episodes, summarise
from drone_env.planning.audit import audit_maps, audited_profile, summarise_audits
from drone_env.planning.optimal import solve

DOCS = Path(__file__).parents[1] / "docs"
AGENTS = ("random", "greedy", "pathqnet", "optimal")
MAPS = 1000
AUDITED = {
    "easy_delivery": 1000,
    "medium_delivery": 200,
    "hard_delivery": 40,
    "skyline_easy": 200,
    "skyline_medium": 20,
}
"""How many test maps the audits of a task run over."""
BEGIN, END = "<!-- audits: written by generate.py -->", "<!-- end of audits -->"


def figures(task: TaskConfig) -> str:
    """The table of how the agents fly a task."""
    lines = ["| agent | mean score | of the optimum | all delivered | mean steps |", "|---|---|---|---|---|"]
    for agent in AGENTS:
        if agent == "pathqnet" and not shipped_network(task).is_file():
            continue
        key = episodes_key(task, agent, split_seeds("test", MAPS), "test")
        of_agent = summarise(run_episodes(key))
        lines.append(
            f"| {agent} | {of_agent['mean_score']:.4f} | {of_agent['score_ratio']:.1%} "
            f"| {of_agent['success_rate']:.1%} | {of_agent['mean_steps']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def picture(task: TaskConfig) -> None:
    """Draw a best flight over the first test map."""
    episode = Episode(task)
    episode.reset(split_seeds("test", 1)[0])
    for action in solve(task, episode.seed).actions:
        episode.step(action)
    save_picture(episode, DOCS / "images" / f"{task.id}.png", 480)


INTRODUCTION = f"""# Tasks

Written by `tools/docs_generate.py` from `TASKS` (`drone_env/core/tasks.py`). [rules.md](rules.md) says what the
numbers mean. The pictures show a best flight over the first test map; the figures are means over the first {MAPS:,}
test maps.

On the three `delivery` tasks chasing the nearest parcel nearly reaches the optimum. The three `skyline` tasks are made
so that it does not: the battery does not last for the tour, buildings cost extra, obstacles block the way, and whoever
does not plan where to charge is left standing. In `skyline` a charge in time is worth more than the steps it takes: a
best flight often tops up before the last delivery, so it can be longer than a shorter one that scores less. On a few
maps nobody can deliver everything; there the optimum is what can be had.
"""


def write_tasks() -> None:
    """Write docs/tasks.md and the pictures."""
    parts = [INTRODUCTION]
    for task in TASKS.values():
        picture(task)
        shown = f"![A best flight on {task.id}](images/{task.id}.png)"
        begin, end = between(task.id)
        parts.append(f"## {task.id}\n\n{shown}\n\n{begin}\n\n{numbers(task)}\n\n{end}\n\n{figures(task)}")
    (DOCS / "tasks.md").write_text("\n".join(parts), encoding="utf-8")


def audits(task: TaskConfig, maps: int) -> list[str]:
    """The rows of a task in the table of audits."""
    rows: list[str] = []
    cases = [(name, gamma, None) for name in REWARD_PROFILES for gamma in (1.0, 0.99)] + [("aligned", 1.0, 0.99)]
    for name, gamma, shaping_gamma in cases:
        profile = audited_profile(name, gamma, shaping_gamma)
        report = summarise_audits(
            task, profile, gamma, list(audit_maps(task, split_seeds("test", maps), profile, gamma))
        )
        mean = report["mean_returns"]
        note = f" (shaping {shaping_gamma})" if shaping_gamma is not None else ""
        verdict = "aligned" if report["verdict"] == "aligned" else "**exploitable**"
        rows.append(
            f"| {task.short_name} | {maps} | `{name}`{note} | {gamma:g} | {verdict} | {report['share_aligned']:.1%} "
            f"| {report['mean_score']:.3f} | {report['mean_optimal_score']:.3f} | {mean['honest']:.2f} "
            f"| {mean['stall']:.2f} | {mean['bump']:.2f} | {mean['oscillate']:.2f} | {mean['hover']:.2f} |"
        )
        print(rows[-1], file=sys.stderr)
    return rows


def write_audits() -> None:
    """Write the table of docs/reward.md."""
    lines = [
        "| task | maps | reward | gamma | verdict | maps on which it reaches the optimum | score of the maximiser "
        "| optimum | return: honest | stall | bump | oscillate | hover |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for task_id, maps in AUDITED.items():
        lines += audits(TASKS[task_id], maps)
    page = DOCS / "reward.md"
    before, rest = page.read_text(encoding="utf-8").split(BEGIN)
    after = rest.split(END)[1]
    page.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    write_tasks()
    if "--tasks" not in sys.argv[1:]:
        write_audits()
