"""The evaluation of a model while it trains: by score, on the maps of validation."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import (
    BaseCallback,
    StopTrainingOnRewardThreshold,
)
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from drone_env import run_episodes, split_seeds, summarise
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.results.evaluate import episodes_key
from drone_env.rl.sb3 import ScoreEvalCallback

MAPS = 20


class Drawn(BaseCallback):
    """Draws the weights anew before each rollout: what training makes of them differs from processor to processor."""

    def _on_rollout_start(self) -> None:
        draw = torch.Generator().manual_seed(self.num_timesteps)
        for weights in self.model.policy.parameters():
            weights.data.normal_(generator=draw)

    def _on_step(self) -> bool:
        return True


def ppo() -> Any:
    env = DroneDeliveryVecEnv("easy", 8, observation="flat")
    return PPO("MlpPolicy", env, n_steps=32, batch_size=64, learning_rate=0.01, seed=1, device="cpu")


def judge(**options: Any) -> ScoreEvalCallback:
    return ScoreEvalCallback(
        "easy", "FlatObservation", **{"n_eval_episodes": MAPS, "eval_freq": 32, "verbose": 0, **options}
    )


@pytest.mark.parametrize("deterministic", [True, False])
def test_it_logs_keeps_and_saves_by_score(deterministic: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged: dict[int, dict[str, Any]] = {}
    dump = Logger.dump

    def told(logger: Logger, step: int = 0) -> None:
        logged.setdefault(step, {}).update(logger.name_to_value)
        dump(logger, step)

    monkeypatch.setattr(Logger, "dump", told)
    model, folder, maps = ppo(), tmp_path / "a" / "b", split_seeds("validation", MAPS)
    callback = judge(deterministic=deterministic, log_path=folder, best_model_save_path=str(folder))
    model.learn(8 * 32 * 6, callback=[Drawn(), callback])

    for _, flown in callback.evaluations:
        assert flown.seeds.tolist() == list(maps)
        assert flown.key.split == "validation"
    steps = [8 * 32 * number for number in range(1, 7)]
    scores = [summarise(flown)["mean_score"] for _, flown in callback.evaluations]
    assert len(set(scores)) > 2
    assert max(scores) > scores[-1]  # the last is not the one to keep
    assert callback.best_mean_reward == max(scores)
    assert callback.last_mean_reward == scores[-1]
    for step, score, (_, flown) in zip(steps, scores, callback.evaluations, strict=True):
        figures = summarise(flown)
        assert logged[step]["eval/mean_score"] == score
        assert logged[step]["eval/mean_regret"] == figures["mean_regret"] > 0
        assert logged[step]["eval/success_rate"] == figures["success_rate"]
        assert logged[step]["eval/mean_ep_length"] == figures["mean_steps"]
        assert logged[step]["time/total_timesteps"] == step

    with np.load(folder / "evaluations.npz") as kept:
        assert kept["timesteps"].tolist() == steps
        assert kept["results"].mean(axis=1) == pytest.approx(scores)
        assert kept["successes"].shape == kept["ep_lengths"].shape == (6, MAPS)
        best = kept["results"][int(np.argmax(scores))].tolist()
    name = f"{folder / 'best_model.zip'}:FlatObservation" + ("" if deterministic else ":sampled")
    assert run_episodes(episodes_key("easy", name, maps)).scores.tolist() == best


def test_what_is_learned_is_the_same_with_it_and_without() -> None:
    learned = [ppo().learn(8 * 32 * 2, callback=callback) for callback in (None, judge(deterministic=False))]
    alone, judged = (model.policy.state_dict() for model in learned)
    assert all(torch.equal(alone[name], judged[name]) for name in alone)


def test_callbacks_that_it_triggers_go_by_score_and_end_the_training(capsys: pytest.CaptureFixture[str]) -> None:
    model = ppo()
    model.learn(8 * 32 * 6, callback=judge(callback_on_new_best=StopTrainingOnRewardThreshold(0.01), verbose=1))
    assert model.num_timesteps == 8 * 32
    assert "256 steps: score 0." in capsys.readouterr().out


def test_what_cannot_be_judged_is_refused_before_the_training() -> None:
    with pytest.raises(InvalidValueError, match="eval_freq=0"):
        judge(eval_freq=0)
    with pytest.raises(CheckpointError, match="behind the wrapper none is"):
        ppo().learn(8, callback=ScoreEvalCallback("easy"))
    env = DroneDeliveryVecEnv("easy", 8, observation="flat")
    network: Any = {"policy_kwargs": {"net_arch": [8]}, "device": "cpu"}
    with pytest.raises(InvalidValueError, match="norm_obs=False"):
        PPO("MlpPolicy", VecNormalize(env), **network).learn(8, callback=judge())
    PPO("MlpPolicy", VecNormalize(env, norm_obs=False), n_steps=8, **network).learn(8, callback=judge())
