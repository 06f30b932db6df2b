"""Drones in RLlib, one by one and many at once: `tools/verify.sh adapters`."""

from collections.abc import Generator
from pathlib import Path
from typing import Any

import gymnasium
import pytest

from drone_env.cluster.connect import connect
from drone_env.envs import wrappers
from drone_env.envs.wrappers import vector
from tests.docs.pages import ROOT, blocks

EASY = "drone_env:DroneDelivery-Easy-v1"
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def cluster() -> Generator[None, None, None]:
    """Ray on this machine."""
    with connect("local", cpus=1):
        yield


@pytest.fixture(autouse=True)
def results(cluster: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """RLlib keeps its results here; without Tune it has no option for that."""
    monkeypatch.setattr("ray.tune.trainable.trainable.DEFAULT_STORAGE_PATH", str(tmp_path))


def one(context: Any) -> Any:
    return wrappers.FlatObservation(gymnasium.make(EASY))


def many(context: Any) -> Any:
    return vector.FlatObservation(gymnasium.make_vec(EASY, num_envs=context["num_envs"]))


def first_iteration(make: Any, mode: str) -> tuple[dict[str, Any], list[Any]]:
    """What one iteration of PPO tells of its flights, and the scores in their last infos."""
    # Here, since their import warns.
    from ray import tune
    from ray.rllib.algorithms.ppo import PPOConfig

    scores: list[Any] = []

    def keep_score(episode: Any, **_: Any) -> None:
        last = episode.get_infos(-1)
        scores.append((last["seed"], last.get("final_info", last)["score"]))

    tune.register_env(make.__name__, make)
    config = PPOConfig().environment(make.__name__).callbacks(on_episode_end=keep_score).debugging(seed=3)
    config.env_runners(num_env_runners=0, num_envs_per_env_runner=8, gym_env_vectorize_mode=mode)
    config.training(train_batch_size=1024, minibatch_size=256, num_epochs=2)
    config.rl_module(model_config={"fcnet_hiddens": [16]})
    algorithm = config.build_algo()
    try:
        told = algorithm.train()
    finally:
        algorithm.stop()
    assert told["learners"]["default_policy"]["mean_kl_loss"] > 0, "the policy has not moved"
    return {name: value for name, value in told["env_runners"].items() if name.startswith("episode_return")}, scores


def test_many_at_once_train_as_one_by_one() -> None:
    singly, singly_scores = first_iteration(one, "sync")
    at_once, at_once_scores = first_iteration(many, "vector_entry_point")
    assert at_once == singly
    assert at_once_scores == singly_scores
    assert len(singly_scores) > 8


def test_the_pages_example_tells_scores(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = [block for block in blocks(ROOT / "docs" / "vector.md") if "RLlib" in (block.not_run or "")]
    exec(compile(block.text, block.where, "exec"), {"__name__": "__main__"})
    scores = [float(line) for line in capsys.readouterr().out.splitlines()[-3:]]
    assert all(0.01 < score < 1 for score in scores)
