"""The evaluation of a model of Stable-Baselines3 while it trains, by score beside the exact optimum."""

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

    Logs `eval/mean_score`, `eval/mean_regret` (where the optimum is known), `eval/success_rate` and
    `eval/mean_ep_length`. What is learned is the same with it and without: it draws from no random numbers of the
    training, and flies on an environment of its own.

    Callbacks that it triggers find the scores under SB3's names, `best_mean_reward` and `last_mean_reward`, so that
    `StopTrainingOnRewardThreshold(0.95)` and `StopTrainingOnNoModelImprovement` go by score.

    Args:
        task: A task or its name.
        wrapper: The wrapper of observations that the model trains behind, or its name, as `evaluate` takes it:
            `FlatObservation` for the environment's form `flat`, `OneHotPlanes` for `dict`, None for none.
        callback_on_new_best: Triggered by each new best mean score.
        callback_after_eval: Triggered by each evaluation.
        n_eval_episodes: How many maps, each flown once.
        eval_freq: Evaluate every so many calls, each of which is a step of all environments.
        log_path: Folder of `evaluations.npz`: `timesteps` int64[E], and for each evaluation and map `results`, the
            scores, float64[E, N], `ep_lengths` int32[E, N] and `successes` bool[E, N], all as SB3 keeps them; besides
            `optimal_scores` float64[N], NaN where no planner knows them.
        best_model_save_path: Folder of `best_model.zip`, the model of the best mean score so far.
        deterministic: Whether the likeliest action is taken; else it is drawn, by the number of the map.
        verbose: 1 to print what came out.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if `n_eval_episodes` or `eval_freq` is below 1. When training begins, too, if the model has
            no probabilities to draw actions by, or is recurrent.
        CheckpointError: when training begins, if the model sees other observations than those behind the wrapper.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        wrapper: Any = None,
        callback_on_new_best: BaseCallback | None = None,
        callback_after_eval: BaseCallback | None = None,
        n_eval_episodes: int = 200,
        eval_freq: int = 10_000,
        log_path: str | Path | None = None,
        best_model_save_path: str | Path | None = None,
        deterministic: bool = True,
        verbose: int = 1,
    ) -> None:
        super().__init__(callback_after_eval, verbose)
        if eval_freq < 1 or n_eval_episodes < 1:
            raise InvalidValueError(f"both must be at least 1: {eval_freq=}, {n_eval_episodes=}")
        self.callback_on_new_best = callback_on_new_best
        if callback_on_new_best is not None:
            callback_on_new_best.parent = self
        self.task, self.wrapper, self.deterministic = get_task(task), wrapper, deterministic
        self.n_eval_episodes, self.eval_freq = n_eval_episodes, eval_freq
        self.log_path = None if log_path is None else Path(log_path)
        self.best_model_save_path = None if best_model_save_path is None else Path(best_model_save_path)
        self.best_mean_reward = self.last_mean_reward = -np.inf
        self.evaluations: list[tuple[int, Results]] = []

    def _init_callback(self) -> None:
        as_agent(self.model, self.task, self.wrapper, not self.deterministic)  # a wrong wrapper is told at once
        for folder in (self.log_path, self.best_model_save_path):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        if self.callback_on_new_best is not None:
            self.callback_on_new_best.init_callback(self.model)

    def _on_step(self) -> bool:
        if self.n_calls % self.eval_freq:
            return True
        flown = evaluate(
            self.model,
            self.task,
            "validation",
            self.n_eval_episodes,
            wrapper=self.wrapper,
            sampled=not self.deterministic,
        )
        self.evaluations.append((self.num_timesteps, flown))
        figures = summarise(flown)
        score, regret = figures["mean_score"], figures["mean_regret"]
        self.logger.record("eval/mean_score", score)
        if regret is not None:
            self.logger.record("eval/mean_regret", regret)
        self.logger.record("eval/mean_ep_length", figures["mean_steps"])
        self.logger.record("eval/success_rate", figures["success_rate"])
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        if self.verbose >= 1:
            beside = "" if regret is None else f", optimum {figures['mean_optimal_score']:.4f}, regret {regret:.4f}"
            best = "; the best so far" if score > self.best_mean_reward else ""
            success = f"{figures['success_rate']:.1%} delivered all"
            print(f"{self.num_timesteps:,} steps: score {score:.4f}{beside}, {success}{best}")
        if self.log_path is not None:
            self._keep(self.log_path / "evaluations.npz")
        self.last_mean_reward, go_on = score, True
        if score > self.best_mean_reward:
            self.best_mean_reward = score
            if self.best_model_save_path is not None:
                with replacing(self.best_model_save_path / "best_model.zip") as path, path.open("wb") as file:
                    self.model.save(file)
            if self.callback_on_new_best is not None:
                go_on = self.callback_on_new_best.on_step()
        return go_on and self._on_event()

    def _keep(self, path: Path) -> None:
        every = [flown for _, flown in self.evaluations]
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                timesteps=[steps for steps, _ in self.evaluations],
                results=[flown.scores for flown in every],
                ep_lengths=[flown.steps for flown in every],
                successes=[flown.success for flown in every],
                optimal_scores=every[0].optimal_scores,
            )

    def update_child_locals(self, locals_: dict[str, Any]) -> None:
        """Hand the local variables of the training on to the callbacks that this one triggers."""
        for callback in (self.callback, self.callback_on_new_best):
            if callback is not None:
                callback.update_locals(locals_)
