"""What a worker does: train one trial up to this many episodes, and judge the network when it is finished.

A trial's own checkpoint is all that it goes on from, so it does not matter who trains it, or how often a worker dies.
"""

import hashlib
import math
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents.pathqnet import load_network
from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.cluster.sweep.folder import MapScores, SweepFolder, TrialState
from drone_env.core.seeds import split_seeds
from drone_env.errors import InvalidValueError
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.rl.dqn import Progress, Trainer
from drone_env.rl.run import TrainingRun


def train_trial(out: Path, until: int, checkpoint_seconds: float, trial: Trial) -> Iterator[dict[str, Any]]:
    """Train a trial up to a rung, or to its end, and write how it stands. What is done already is not done again.

    Yields `episodes`, `validation` and `optimum` at every validation; `failed`, the error, where training goes wrong:
    that is the trial's result.

    Args:
        out: The sweep's folder.
        until: How many episodes to train to.
        checkpoint_seconds: Seconds between two checkpoints.
        trial: Which trial.

    Raises:
        InvalidValueError: if this machine does not see the sweep's folder, or another process trains the trial.
    """
    folder = SweepFolder(out)
    if not folder.path.is_dir():
        raise InvalidValueError(f"this machine has no {folder.path}: a sweep's folder lies where all machines see it")
    place = folder.folder(trial)
    with folder.training(trial):
        state = folder.state(trial)
        if state.status != "unfinished" or str(until) in state.rungs:
            return
        config = folder.config()
        try:
            run = TrainingRun(Trainer(config.training(trial, checkpoint_seconds)), place, place)
            folder.note_part(trial, run.trainer.episodes)
            yield from _train(run, until)
            state = _state(run, state, until)
            if run.trainer.episodes >= run.trainer.config.episodes:
                state = _judged(state, config, run)
        except Exception as error:
            last = traceback.format_exception_only(type(error), error)[-1].strip()
            state = folder.state(trial).model_copy(update={"status": "failed", "error": last})
        folder.set_state(trial, state)
        if state.status == "failed":
            yield {"failed": state.error}


def network_digest(path: Path) -> str:
    """SHA-256 of an exported network's parameters, by name, 16 hex digits."""
    hashed = hashlib.sha256()
    for name, array in sorted(load_network(path).parameters.items()):
        hashed.update(name.encode() + b"\0" + np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()[:16]


def best_until(history: Sequence[Progress], episodes: int) -> float:
    """The best validation score on the log up to its first line at or after this many episodes."""
    first = next((i for i, line in enumerate(history) if line.episode >= episodes), len(history))
    return max((line.validation for line in history[: first + 1] if not math.isnan(line.validation)), default=-math.inf)


def _train(run: TrainingRun[Trainer], until: int) -> Iterator[dict[str, Any]]:
    """Train to the first line of the log at or after this many episodes; not at all where that is done."""
    history, every = run.trainer.history, run.trainer.config.validation_every
    if run.trainer.episodes >= run.trainer.config.episodes or (history and history[-1].episode >= until):
        return
    reported = run.trainer.episodes
    for line in run.train():
        if run.stopped:
            continue  # a line of the same step as the last that is wanted
        if line.episode // every > reported // every or line.episode >= until:
            reported = line.episode
            optimum = run.trainer.metadata()["validation_optimum"]
            yield {"episodes": line.episode, "validation": line.validation, "optimum": optimum}
        run.stopped = line.episode >= until


def _state(run: TrainingRun[Trainer], before: TrialState, until: int) -> TrialState:
    trainer, config = run.trainer, run.trainer.config
    every = config.validation_every
    curve: list[tuple[int, float]] = []
    for line in trainer.history:
        due = line.episode // every > (curve[-1][0] // every if curve else 0) or line.episode == config.episodes
        if due and not math.isnan(line.validation):
            curve.append((line.episode, line.validation))
    return TrialState(
        rungs={**before.rungs, str(until): best_until(trainer.history, until)},
        episodes=trainer.episodes,
        steps=trainer.steps,
        updates=trainer.updates,
        seconds=round(run.seconds, 1),
        curve=curve,
        validation_score=trainer.best_score,
        validation_optimum=trainer.metadata()["validation_optimum"],
    )


def _judged(state: TrialState, config: SweepConfig, run: TrainingRun[Trainer]) -> TrialState:
    """The state with how the best network flies the test maps."""
    key = episodes_key(config.task, f"pathqnet:{run.network}", split_seeds("test", config.test_maps), "test")
    flown = run_episodes(key)
    solved = not np.isnan(flown.optimal_scores).any()
    test = MapScores(
        scores=flown.scores.tolist(),
        optima=flown.optimal_scores.tolist() if solved else None,
        success_rate=float(flown.success.mean()),
    )
    return state.model_copy(update={"status": "finished", "network": network_digest(run.network), "test": test})
