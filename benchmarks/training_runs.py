"""Train every task from scratch with several seeds, and fly the test maps.

Each run is `drone-env train` with its defaults. Its folder is under `results/evidence/`. Run the command again
to resume; a finished run is only flown again. Training sees train and validation maps only; the last columns are of
test maps.

    python benchmarks/training_runs.py                                                     # PathQNet
    OMP_NUM_THREADS=1 python benchmarks/training_runs.py --algorithm ppo --seeds 0 1 2 3 4
"""

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.config import ppo_preset, preset
from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.run import TrainingRun
from drone_env.rl.trainer import Trainer

ROOT = Path(__file__).resolve().parent.parent
MAPS = 1000
AGENTS = {"dqn": "pathqnet", "ppo": "ppo"}
HEADER = (
    "| task | seed | minutes | CPU s | updates | steps | best validation | score | optimum | ratio | delivered |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def fly_test_maps(task: TaskConfig, agent: str) -> dict[str, Any]:
    """The summary of an agent's flights over the test maps."""
    return summarise(run_episodes(episodes_key(task, agent, split_seeds("test", MAPS), "test")))


def train(algorithm: str, task: TaskConfig, seed: int, threads: int, folder: Path) -> TrainingRun:
    """Train one network to the end, or continue its training."""
    if algorithm == "ppo":
        trainer: Any = PpoTrainer(replace(ppo_preset(task.short_name), seed=seed))
    else:
        trainer = Trainer(replace(preset("fast", task.short_name), seed=seed, num_threads=threads))
    run = TrainingRun(trainer, folder, folder)
    with run.stopping_on_interrupt():
        for line in run.train():
            print(f"{folder.name}: {run.done}/{run.total}, {line.validation:.4f}", file=sys.stderr, flush=True)
    if run.stopped:
        sys.exit(130)
    return run


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--algorithm", choices=AGENTS, default="dqn")
    parser.add_argument("--tasks", nargs="+", default=["easy", "medium", "hard"], help=f"of {', '.join(TASKS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--threads", type=int, default=2, help="PyTorch threads of PathQNet (%(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "evidence")
    arguments = parser.parse_args()
    print(HEADER)
    for task in map(get_task, arguments.tasks):
        for seed in arguments.seeds:
            folder = arguments.out.resolve() / f"{arguments.algorithm}-{task.id}-seed{seed}"
            run = train(arguments.algorithm, task, seed, arguments.threads, folder)
            test, trainer = fly_test_maps(task, f"{AGENTS[arguments.algorithm]}:{run.network}"), run.trainer
            seconds = getattr(trainer.history[-1], "cpu_seconds", math.nan)
            best = trainer.best_score / trainer.validator.optimum
            print(
                f"| {task.short_name} | {seed} | {run.seconds / 60:.1f} | {seconds:.1f} "
                f"| {trainer.updates:,} | {trainer.steps:,} | {best:.4f} | {test['mean_score']:.4f} "
                f"| {test['mean_optimal_score']:.4f} | {test['score_ratio']:.4f} | {test['success_rate']:.1%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
