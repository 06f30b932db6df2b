"""Evaluation of a Stable-Baselines3 model during training, by score."""

from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents.named import as_agent
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.files import replacing
from drone_env.results.evaluate import evaluate, summarise
from drone_env.results.result import Results

try:
    from stable_baselines3.common.callbacks import BaseCallback, EventCallback
except ModuleNotFoundError as error:
    raise ImportError("drone_env.rl.sb3 needs Stable-Baselines3: pip install stable-baselines3") from error


class ScoreEvalCallback(EventCallback):
    """SB3's `EvalCallback`, by score: flies the first validation maps with `drone_env.evaluate`.

    It logs `eval/mean_score`, `eval/mean_regret` (if the optimum is known), `eval/success_rate` and
    `eval/mean_ep_length`. It does not change the training: it uses its own environment and no random numbers.

    Args:
        task: A task or its name.
        wrapper: The observation wrapper of the model's training, or its name, as in `evaluate`: `FlatObservation` for
            the form `flat`, `OneHotPlanes` for `dict`, None for none.
        callback_on_new_best: Triggered by each new best mean score. It finds the score as `best_mean_reward`, so
            `StopTrainingOnRewardThreshold(0.95)` stops at that score.
        n_eval_episodes: Number of maps; each is flown once.
        eval_freq: Evaluate every `eval_freq` calls; a call is one step of all environments.
        best_model_save_path: Folder of `best_model.zip`, the model with the best mean score so far.
        verbose: 1 to print each result.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if `n_eval_episodes` or `eval_freq` is below 1.
        CheckpointError: when training begins, if the model takes other observations than the wrapped task has.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        wrapper: Any = None,
        callback_on_new_best: BaseCallback | None = None,
        n_eval_episodes: int = 200,
        eval_freq: int = 10_000,
        best_model_save_path: str | Path | None = None,
        verbose: int = 1,
    ) -> None:
        super().__init__(callback_on_new_best, verbose)
        if eval_freq < 1 or n_eval_episodes < 1:
            raise InvalidValueError(f"both must be at least 1: {eval_freq=}, {n_eval_episodes=}")
        self.task, self.wrapper = get_task(task), wrapper
        self.n_eval_episodes, self.eval_freq = n_eval_episodes, eval_freq
        self.best_model_save_path = None if best_model_save_path is None else Path(best_model_save_path)
        self.best_mean_reward = -np.inf
        self.evaluations: list[tuple[int, Results]] = []

    def _init_callback(self) -> None:
        super()._init_callback()
        as_agent(self.model, self.task, self.wrapper)  # raises before the training if the wrapper is wrong
        if self.best_model_save_path is not None:
            self.best_model_save_path.mkdir(parents=True, exist_ok=True)

    def _on_step(self) -> bool:
        if self.n_calls % self.eval_freq:
            return True
        results = evaluate(self.model, self.task, "validation", self.n_eval_episodes, wrapper=self.wrapper)
        self.evaluations.append((self.num_timesteps, results))
        figures = summarise(results)
        score = figures["mean_score"]
        names = {"mean_ep_length": "mean_steps"} | {k: k for k in ("mean_score", "mean_regret", "success_rate")}
        for name, figure in names.items():
            if figures[figure] is not None:
                self.logger.record(f"eval/{name}", figures[figure])
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        if self.verbose >= 1:
            print(f"{self.num_timesteps:,} steps: score {score:.4f}, success {figures['success_rate']:.1%}")
        if score <= self.best_mean_reward:
            return True
        self.best_mean_reward = score
        if self.best_model_save_path is not None:
            with replacing(self.best_model_save_path / "best_model.zip") as path, path.open("wb") as file:
                self.model.save(file)
        return self._on_event()
