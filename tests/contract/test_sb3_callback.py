"""The evaluation of a model during training: by score, on the validation maps."""

from pathlib import Path
from typing import Any

import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, StopTrainingOnRewardThreshold
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecNormalize

from drone_env import run_episodes, split_seeds, summarise
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.results.evaluate import episodes_key
from drone_env.rl.sb3 import ScoreEvalCallback

MAPS = 20
STEPS = range(8 * 32, 8 * 32 * 7, 8 * 32)


class RandomWeights(BaseCallback):
    """Sets random weights before each rollout: trained weights differ between processors."""

    def _on_rollout_start(self) -> None:
        generator = torch.Generator().manual_seed(self.num_timesteps)
        for weights in self.model.policy.parameters():
            weights.data.normal_(generator=generator)

    def _on_step(self) -> bool:
        return True


def ppo() -> Any:
    env = DroneDeliveryVecEnv("easy", 8, observation="flat")
    return PPO("MlpPolicy", env, n_steps=32, batch_size=64, learning_rate=0.01, seed=1, device="cpu")


def callback_with(**options: Any) -> ScoreEvalCallback:
    return ScoreEvalCallback(
        "easy", "FlatObservation", **{"n_eval_episodes": MAPS, "eval_freq": 32, "verbose": 0, **options}
    )


def test_it_logs_and_saves_by_score(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logged: dict[int, dict[str, Any]] = {}
    dump = Logger.dump

    def record(logger: Logger, step: int = 0) -> None:
        logged.setdefault(step, {}).update(logger.name_to_value)
        dump(logger, step)

    monkeypatch.setattr(Logger, "dump", record)
    folder, maps = tmp_path / "a" / "b", split_seeds("validation", MAPS)
    callback = callback_with(best_model_save_path=str(folder))
    ppo().learn(STEPS[-1], callback=[RandomWeights(), callback])

    assert [step for step, _ in callback.evaluations] == [*STEPS]
    scores = [summarise(results)["mean_score"] for _, results in callback.evaluations]
    assert callback.best_mean_reward == max(scores) > scores[-1]
    for step, results in callback.evaluations:
        assert results.seeds.tolist() == list(maps)
        assert results.key.split == "validation"
        figures = summarise(results)
        assert logged[step]["eval/mean_score"] == figures["mean_score"]
        assert logged[step]["eval/mean_regret"] == figures["mean_regret"] > 0
        assert logged[step]["eval/success_rate"] == figures["success_rate"]
        assert logged[step]["eval/mean_ep_length"] == figures["mean_steps"]
    best = callback.evaluations[scores.index(max(scores))][1].scores.tolist()
    name = f"{folder / 'best_model.zip'}:FlatObservation"
    assert run_episodes(episodes_key("easy", name, maps)).scores.tolist() == best


def test_it_does_not_change_the_training() -> None:
    learned = [ppo().learn(8 * 32 * 2, callback=callback) for callback in (None, callback_with())]
    alone, evaluated = (model.policy.state_dict() for model in learned)
    assert all(torch.equal(alone[name], evaluated[name]) for name in alone)


def test_a_threshold_is_one_of_score(capsys: pytest.CaptureFixture[str]) -> None:
    model = ppo()
    model.learn(STEPS[-1], callback=callback_with(callback_on_new_best=StopTrainingOnRewardThreshold(0.01), verbose=1))
    assert model.num_timesteps == STEPS[0]
    assert "256 steps: score 0." in capsys.readouterr().out


def test_invalid_arguments_are_rejected_before_the_training() -> None:
    with pytest.raises(InvalidValueError, match="eval_freq=0"):
        callback_with(eval_freq=0)
    with pytest.raises(CheckpointError, match="with wrapper none has"):
        ppo().learn(8, callback=ScoreEvalCallback("easy"))
    env = DroneDeliveryVecEnv("easy", 8, observation="flat")
    network: Any = {"policy_kwargs": {"net_arch": [8]}, "device": "cpu"}
    with pytest.raises(InvalidValueError, match="norm_obs=False"):
        PPO("MlpPolicy", VecNormalize(env), **network).learn(8, callback=callback_with())
    PPO("MlpPolicy", VecNormalize(env, norm_obs=False), n_steps=8, **network).learn(8, callback=callback_with())
