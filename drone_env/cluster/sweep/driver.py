"""Drives a sweep: gives its trials to Ray Tune, rung by rung, and decides between the rungs.

What counts is in the sweep's folder, written by the trials themselves: a new driver reads it and goes on. Ray Tune
writes notes of its own, but ten seconds or more apart, so a driver that is killed leaves them behind the truth; they
are never read, and removed when Tune has ended.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

from drone_env.cluster.nodes import check_cpus, this_driver
from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.cluster.sweep.folder import SweepFolder
from drone_env.cluster.sweep.halving import decide, remaining, rungs
from drone_env.cluster.sweep.trial import run_trial

RETRIES = 3
"""How many times a trial whose worker died is taken up again."""

Show = Callable[[Trial, dict[str, Any]], None]


def drive(folder: SweepFolder, config: SweepConfig, checkpoint_seconds: float, concurrent: int, show: Show) -> None:
    """Train all trials that are not done. Ray is connected.

    Args:
        folder: The sweep's folder; this process drives it.
        config: What it is.
        checkpoint_seconds: Seconds between two checkpoints of a trial.
        concurrent: How many trials train side by side at most; 0 for as many as there are CPUs for.
        show: Called with a trial and what it reports.

    Raises:
        ClusterError: if no node offers the CPUs of a trial.
        KeyboardInterrupt: if Ctrl-C ended it.
    """
    check_cpus(config.cpus_per_trial)
    for left in folder.path.glob("tune-*"):
        shutil.rmtree(left, ignore_errors=True)
    for episodes in rungs(config):
        _train_all(folder, config, episodes, checkpoint_seconds, concurrent, show)
        decide(folder, config, episodes)
    _train_all(folder, config, _end(config), checkpoint_seconds, concurrent, show)


def is_done(folder: SweepFolder, config: SweepConfig) -> bool:
    """Whether nothing is left to train or to decide."""
    decided = {decision.episodes for decision in folder.stopped()}
    return decided >= set(rungs(config)) and not outstanding(folder, config, _end(config))


def _end(config: SweepConfig) -> int:
    return max(config.training(trial).episodes for trial in config.trials())


def outstanding(folder: SweepFolder, config: SweepConfig, until: int) -> list[Trial]:
    """The trials that have not got so far, failed, or been stopped."""
    alive = remaining(config, folder.stopped())
    states = {trial: folder.state(trial) for trial in config.trials() if trial.setting in alive}
    return [trial for trial, state in states.items() if state.status == "unfinished" and str(until) not in state.rungs]


def retry_failed(folder: SweepFolder, config: SweepConfig) -> None:
    """Take back that trials failed, so that they go on from their checkpoints."""
    for trial in config.trials():
        state = folder.state(trial)
        if state.status == "failed":
            folder.set_state(trial, state.model_copy(update={"status": "unfinished", "error": None}))


def _train_all(
    folder: SweepFolder, config: SweepConfig, until: int, checkpoint_seconds: float, concurrent: int, show: Show
) -> None:
    trials = outstanding(folder, config, until)
    if not trials:
        return
    out = str(folder.path.resolve())
    shared = {"out": out, "until": until, "checkpoint_seconds": checkpoint_seconds, "driver": this_driver()}
    with tempfile.TemporaryDirectory(prefix="tune-", dir=out) as notes:
        errors = _tune(shared, trials, config.cpus_per_trial, concurrent, notes, show)
    for trial, error in errors.items():
        state = folder.state(trial)
        if state.status == "unfinished" and str(until) not in state.rungs:
            folder.set_state(trial, state.model_copy(update={"status": "failed", "error": error}))
    if outstanding(folder, config, until):
        raise KeyboardInterrupt  # Tune takes Ctrl-C for an order to end well


def _tune(
    shared: dict[str, Any], trials: Sequence[Trial], cpus: int, concurrent: int, notes: str, show: Show
) -> dict[Trial, str]:
    """Run the trials; the errors of those that were given up."""
    # What a trial reports is shown here and kept in its folder: Tune need neither print it nor keep it too.
    os.environ["TUNE_DISABLE_AUTO_CALLBACK_LOGGERS"] = "1"
    os.environ["RAY_AIR_NEW_OUTPUT"] = "0"
    logging.getLogger("ray.tune.analysis.experiment_analysis").setLevel(logging.ERROR)
    import ray.tune as ray_tune

    tune: Any = ray_tune

    class Shown(tune.Callback):
        def on_trial_result(self, iteration: int, trials: Any, trial: Any, result: dict[str, Any], **info: Any) -> None:
            if "episodes" in result or "failed" in result:
                show(Trial(*trial.config["trial"]), result)

    def name(trial: Any) -> str:
        return Trial(*trial.config["trial"]).name

    grid = tune.Tuner(
        tune.with_resources(run_trial, {"cpu": cpus}),
        param_space={**shared, "trial": tune.grid_search([list(trial) for trial in trials])},
        tune_config=tune.TuneConfig(
            max_concurrent_trials=concurrent or None,
            trial_name_creator=name,
            trial_dirname_creator=name,
            reuse_actors=True,  # a new one would load PyTorch anew for each trial
        ),
        run_config=tune.RunConfig(
            name="sweep",
            storage_path=notes,
            verbose=0,
            failure_config=tune.FailureConfig(max_failures=RETRIES),
            callbacks=[Shown()],
        ),
    ).fit()
    return {Trial(*result.config["trial"]): _last_line(result.error) for result in grid if result.error is not None}


def _last_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[-1] if lines else 'no message'}"
