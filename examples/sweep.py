"""Compare training settings over several seeds with Optuna; each network is evaluated against the exact optimum.

    pip install -e '.[train]' optuna
    python examples/sweep.py --out runs/sweep

Edit `GRID` for your settings: every field of `TrainConfig`. A trial is one setting with all its seeds, so pruning
never keeps the lucky seeds of a setting and stops the others. To use more processors, run the command several times
with the same folder. To resume, run it again: a setting continues from its checkpoints.
"""

import argparse
import math
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import optuna

from drone_env import evaluate
from drone_env.agents import make_agent
from drone_env.rl.config import preset
from drone_env.rl.run import TrainingRun
from drone_env.rl.trainer import Trainer

GRID: dict[str, Any] = {"learning_rate": [1e-3, 3e-4], "batch_size": [64, 128]}

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--task", default="easy")
parser.add_argument("--episodes", type=int, default=1000)
parser.add_argument("--seeds", type=int, default=3)
parser.add_argument("--maps", type=int, default=500, help="number of validation and test maps (%(default)s)")
parser.add_argument("--out", type=Path, default=Path("runs/sweep"))
args = parser.parse_args()


def train(trial: optuna.Trial) -> float:
    """Train a setting with all seeds side by side; return the mean of their best validation scores."""
    setting = {name: trial.suggest_categorical(name, values) for name, values in GRID.items()}
    # The name of the setting: when Optuna repeats the trial of a killed process, it finds the checkpoints.
    folder = args.out / " ".join(f"{name}={value}" for name, value in setting.items())
    config = replace(preset("fast", args.task, args.episodes), num_threads=1, validation_maps=args.maps, **setting)
    folders = [folder / f"seed{seed}" for seed in range(args.seeds)]
    runs = [TrainingRun(Trainer(replace(config, seed=seed)), path, path) for seed, path in enumerate(folders)]
    best = [max((line.validation for line in run.trainer.history), default=math.nan) for run in runs]
    for lines in zip_longest(*(run.train() for run in runs)):
        best = [np.fmax(score, line.validation).item() for score, line in zip(best, lines, strict=True)]
        if not math.isnan(lines[0].validation):
            trial.report(fmean(best), lines[0].episode)
            if trial.should_prune():
                raise optuna.TrialPruned
    flown = [evaluate(make_agent(f"pathqnet:{run.network}", args.task), args.task, "test", args.maps) for run in runs]
    scores = [results.scores.mean() for results in flown]
    low, high, optimum = min(scores), max(scores), flown[0].optimal_scores.mean()
    trial.set_user_attr("test", f"score {fmean(scores):.4f}, seeds {low:.4f} to {high:.4f}, optimum {optimum:.4f}")
    return fmean(best)


args.out.mkdir(parents=True, exist_ok=True)
study = optuna.create_study(
    storage=f"sqlite:///{args.out / 'sweep.db'}",
    study_name=args.task,
    sampler=optuna.samplers.GridSampler(GRID),
    pruner=optuna.pruners.HyperbandPruner(args.episodes // 9 or 1, args.episodes),
    direction="maximize",
    load_if_exists=True,
)
study.optimize(train)
for trial in sorted(study.get_trials(), key=lambda trial: trial.value or -1, reverse=True):
    print(trial.number, trial.params, trial.state.name.lower(), trial.value, trial.user_attrs.get("test", "-"))
