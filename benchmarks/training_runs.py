"""Train every task from scratch with several seeds and fly the test maps.

Each run is `drone-env train` with its defaults. Its folder is under `results/evidence/`. Run the command again
to resume; a finished run is only flown again. Training sees train and validation maps only; the table is of test maps.
"""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.config import preset
from drone_env.rl.run import TrainingRun
from drone_env.rl.trainer import Trainer

ROOT = Path(__file__).resolve().parent.parent
MAPS = 1000
HEADER = (
    "| task | seed | minutes | updates | steps | score | optimum | ratio | greedy's | delivered |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def fly_test_maps(task: TaskConfig, agent: str) -> dict[str, Any]:
    """The summary of an agent's flights over the test maps."""
    return summarise(run_episodes(episodes_key(task, agent, split_seeds("test", MAPS), "test")))


def train(task: TaskConfig, seed: int, threads: int, folder: Path) -> TrainingRun:
    """Train one network to the end, or continue its training."""
    config = dataclasses.replace(preset("fast", task.short_name), seed=seed, num_threads=threads)
    run = TrainingRun(Trainer(config), folder, folder)
    with run.stopping_on_interrupt():
        for line in run.train():
            if line.episode % config.validation_every == 0:
                print(f"{folder.name}: {run.done}/{run.total}, {line.validation:.4f}", file=sys.stderr, flush=True)
    if run.stopped:
        sys.exit(130)
    return run


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["easy", "medium", "hard"], help=f"of {', '.join(TASKS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--threads", type=int, default=2, help="PyTorch threads (%(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "evidence")
    arguments = parser.parse_args()
    print(HEADER)
    for task in map(get_task, arguments.tasks):
        greedy = fly_test_maps(task, "greedy")["score_ratio"]
        for seed in arguments.seeds:
            run = train(task, seed, arguments.threads, arguments.out.resolve() / f"{task.id}-seed{seed}")
            test, trainer = fly_test_maps(task, f"pathqnet:{run.network}"), run.trainer
            print(
                f"| {task.id} | {seed} | {run.seconds / 60:.1f} | {trainer.updates:,} | {trainer.steps:,} "
                f"| {test['mean_score']:.4f} | {test['mean_optimal_score']:.4f} | {test['score_ratio']:.4f} "
                f"| {greedy:.4f} | {test['success_rate']:.1%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
