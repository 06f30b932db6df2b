"""The page's example of Weights & Biases, offline, with each algorithm: `tools/verify.sh adapters`."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.run import TrainingRun
from drone_env.rl.tournet import TourTrainer
from drone_env.rl.trainer import Trainer
from tests.docs.pages import ROOT, blocks
from tests.tools import ran
from tests.unit.small_training import SMALL, SMALL_PPO, SMALL_TOUR


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("make", "config"),
    [
        (Trainer, replace(SMALL, episodes=20)),
        (PpoTrainer, replace(SMALL_PPO, steps=128)),
        (TourTrainer, SMALL_TOUR),
    ],
)
def test_wandb_gets_the_curves_of_a_run_and_of_a_resumed_one(make: Any, config: Any, tmp_path: Path) -> None:
    (example,) = [block.text for block in blocks(ROOT / "docs" / "learning.md") if "wandb" in (block.not_run or "")]
    run = TrainingRun(make(config), tmp_path / "data", tmp_path / "results")
    lines = run.train()
    begun = next(lines)
    run.save()
    lines.close()
    (run.results / "config.toml").replace(tmp_path / "run.toml")
    done = ran(sys.executable, "-c", example, cwd=tmp_path, WANDB_MODE="offline")
    assert f"going on from data/{run.name}.pth" in done.stderr
    history, summary = done.stderr.split("Run history:")[1].split("Run summary:")
    assert "cpu_seconds" in history
    last = next(int(line.split()[-1]) for line in summary.splitlines() if "global_step" in line)
    assert last >= run.total > next(iter(vars(begun).values()))
