"""Write the parts of the documentation that take minutes to compute.

    tasks   docs/images/<task>.png, and preview.png of the page
    results drone_env/results/shipped.tar.xz: every agent over 1,000 test maps of every task; flies what it lacks
    leaderboard  leaderboard/*.jsonl: every agent over 100 of them, with its actions
    audits  docs/reward.md: the table of audits
    curves  docs/reward.md and docs/images/training/*.png: training on `tiered` and on `aligned`

`python tools/docs_generate.py tasks curves` writes these alone; without a name, all but curves. Curves need PyTorch.
"""

import sys
import tarfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from docs_tables import SUBMISSIONS, put

from drone_env.agents import AGENTS, make_agent
from drone_env.commands.submit import submit
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES, get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.envs.rendering import save_picture
from drone_env.errors import TooLargeError, UnsupportedTaskError
from drone_env.files import replacing
from drone_env.planning.audit import audit_maps, summarise_audits
from drone_env.planning.optimal import require_solvable, solve
from drone_env.results.evaluate import episodes_key, evaluate_keys, local_engine
from drone_env.results.folder import SHIPPED, ResultsFolder, shipped_results
from drone_env.results.result import EpisodesKey
from drone_env.results.tables import markdown
from drone_env.server.page_files import PAGE

DOCS = Path(__file__).parents[1] / "docs"
REWARD = DOCS / "reward.md"
MAPS = 1000
"""Test maps of each task in the shipped results."""
AUDITED = {"easy_delivery": 1000, "hard_delivery": 40, "skyline_easy": 200}
"""How many test maps the audits of a task run over."""
CURVES, CURVES_EPISODES = "easy", 1_500
"""The task of the curves, and how many episodes are enough to see which way each goes."""


def picture(task: TaskConfig, seed: int, file: Path, pixels: int) -> None:
    """Draw a best flight over a map."""
    save_picture(Episode(task, seed=seed).fly(solve(task, seed).actions), file, pixels)


def write_results() -> None:
    """Fly every agent over the test maps of every task, unless the shipped results have them, and ship the results."""
    keys: list[EpisodesKey] = []
    for task in TASKS.values():
        for agent in AGENTS:
            with suppress(UnsupportedTaskError, TooLargeError):
                if agent == "optimal":
                    require_solvable(task)
                keys.append(episodes_key(task, agent, split_seeds("test", MAPS), "test"))
    with TemporaryDirectory() as temporary:
        folder = ResultsFolder(Path(temporary, "results"), keys)
        for key in keys:
            if (shipped := shipped_results(key)) is not None:
                folder.save(shipped)
        evaluate_keys(keys, local_engine, folder, lambda flown: print(flown.key.task, flown.key.agent, file=sys.stderr))
        with replacing(SHIPPED) as archive_file, tarfile.open(archive_file, "w:xz", preset=9) as archive:
            archive.add(temporary, "", filter=_anonymous)


def _anonymous(file: tarfile.TarInfo) -> tarfile.TarInfo:
    """A file without owner and time: equal results give equal archives."""
    file.mtime = file.uid = file.gid = 0
    file.uname = file.gname = ""
    return file


def write_leaderboard() -> None:
    """Submit every agent to the leaderboard, with the tasks that it can fly."""
    for agent in AGENTS:
        tasks: list[str] = []
        for task in TASKS.values():
            with suppress(UnsupportedTaskError, TooLargeError):
                make_agent(agent, task)
                tasks.append(task.id)
        submit("docs/benchmark.md", SUBMISSIONS / f"{agent}.jsonl", agent, task=tuple(tasks))


def write_tasks() -> None:
    """Draw a best flight of every task."""
    for task in TASKS.values():
        picture(task, split_seeds("test", 1)[0], DOCS / "images" / f"{task.id}.png", 480)
    picture(TASKS["skyline_medium"], 43, PAGE / "preview.png", 630)


def audits(task: TaskConfig, maps: int) -> list[str]:
    """The rows of a task in the table of audits."""
    rows: list[str] = []
    cases = [(name, 1.0, None) for name in REWARD_PROFILES]
    cases += [("aligned", 0.99, None), ("score", 0.99, None), ("aligned", 1.0, 0.99)]
    for name, gamma, shaping_gamma in cases:
        profile = profile_for_discount(get_reward_profile(name), shaping_gamma or gamma)
        report = summarise_audits(
            task, profile, gamma, list(audit_maps(task, split_seeds("test", maps), profile, gamma))
        )
        first = f"{task.short_name}: {maps} maps, optimum {report['mean_optimal_score']:.3f}" if not rows else ""
        note = f" (shaping {shaping_gamma})" if shaping_gamma is not None else ""
        bold = "" if report["verdict"] == "aligned" else "**"
        rows.append(
            f"| {first} | `{name}`{note} | {gamma:g} | {bold}{report['share_aligned']:.1%}{bold} "
            f"| {report['mean_score']:.3f} | {report['mean_returns']['honest']:.2f} |"
        )
        print(rows[-1], file=sys.stderr)
    return rows


def write_audits() -> None:
    """Write the table of audits in docs/reward.md."""
    lines = [
        "| task | reward | gamma | maps on which it reaches the optimum | score of the maximiser | return: honest |",
        "|---|---|---|---|---|---|",
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
    for name in ("reward", "length", "loss", "validation"):
        pyplot.figure(figsize=(7, 4), layout="constrained")
        for reward, history in histories.items():
            pyplot.plot([line.episode for line in history], [getattr(line, name) for line in history], label=reward)
        pyplot.xlabel("episodes")
        pyplot.ylabel(name)
        pyplot.legend()
        pyplot.savefig(DOCS / "images" / "training" / f"{name}.png", dpi=120)
    REWARD.write_text(put(REWARD.read_text(encoding="utf-8"), "curves", markdown(rows)), encoding="utf-8")


if __name__ == "__main__":
    parts = {"results": write_results, "leaderboard": write_leaderboard, "tasks": write_tasks, "audits": write_audits}
    parts_by_name = parts | {"curves": write_curves}
    for name in sys.argv[1:] or parts:
        parts_by_name[name]()
