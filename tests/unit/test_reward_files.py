"""A reward profile from a file of one's own, wherever one is named."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from drone_env.cli import main
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.reward_file import load_reward_profile
from drone_env.rl.config import TrainConfig

EASY = "drone_env:DroneDelivery-Easy-v1"
MINE = """
id = "mine"
[events]
step = -0.25
wait = 0.5
delivery = 7
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file, in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.toml"
    path.write_text(MINE)
    return path


def run(*arguments: str) -> int:
    return main(arguments)


def test_a_command_pays_by_the_file(mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = ["fly", "--task", "easy", "--seed", "14", "--reward-profile"]
    assert run(*flight, "mine.toml", "--record", "flight.json") == 0
    assert capsys.readouterr().out.endswith("rewards=-0.25,-0.25,7.00\n")
    del REWARD_PROFILES["mine"]  # as in the next process
    assert run("replay", "flight.json") == 2
    assert "unknown reward profile 'mine'" in capsys.readouterr().err
    assert run("replay", "flight.json", "--reward", "mine.toml") == 0
    mine.write_text('id = "mine"\nbonus = 1')
    assert run(*flight, "mine.toml") == 2
    assert "reward profile mine.toml: bonus: Extra inputs are not permitted" in capsys.readouterr().err


def test_a_training_continues_with_the_same_rewards_only(mine: Path) -> None:
    def identity() -> dict[str, object]:
        REWARD_PROFILES["mine"] = load_reward_profile(mine)
        return TrainConfig(task="easy", reward_profile="mine").identity()

    before = identity()
    assert identity() == before
    mine.write_text(MINE.replace("-0.25", "-0.5"))
    assert identity() != before


def test_environments_pay_by_the_file(mine: Path) -> None:
    single = gymnasium.make(EASY, reward_profile="mine.toml")
    single.reset(seed=14)
    assert single.step(4)[1] == 0.5
    batch = gymnasium.make_vec(EASY, num_envs=2, reward_profile=str(mine))
    batch.reset(seed=14)
    assert batch.step(np.array([4, 2]))[1].tolist() == [0.5, -0.25]
    sb3 = DroneDeliveryVecEnv("easy", 2, reward_profile="mine.toml")
    sb3.seed(14)
    sb3.reset()
    assert sb3.step(np.array([4, 2]))[1].tolist() == [0.5, -0.25]
