"""Drives a sweep: hands out its trials, rung by rung, and decides between the rungs.

What counts is in the sweep's folder, written by the trials themselves: a new driver reads it and goes on.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.cluster.sweep.folder import SweepFolder
from drone_env.cluster.sweep.halving import decide, remaining, rungs
from drone_env.cluster.sweep.trial import train_trial

TRIES = 4
"""How often a trial is taken up whose worker dies."""

Show = Callable[[Trial, dict[str, Any]], None]


def drive(
    folder: SweepFolder, config: SweepConfig, checkpoint_seconds: float, concurrent: int | None, show: Show
) -> None:
    """Train all trials that are not done. Ray is connected.

    Args:
        folder: The sweep's folder; this process drives it.
        config: What it is.
        checkpoint_seconds: Seconds between two checkpoints of a trial.
        concurrent: How many trials train side by side at most; None for as many as there are CPUs for.
        show: Called with a trial and what it reports.

    Raises:
        ClusterError: if no node offers the CPUs of a trial, or one has another package than this one.
        InvalidValueError: if a node does not see the sweep's folder.
    """
    from drone_env.cluster.jobs import run_jobs  # needs Ray, and the other functions here do not

    for until in (*rungs(config), _end(config)):
        train = partial(train_trial, folder.path.resolve(), until, checkpoint_seconds)
        give_up, trials = partial(_give_up, folder), outstanding(folder, config, until)
        for trial, report in run_jobs(train, trials, TRIES, give_up, config.cpus_per_trial, concurrent):
            show(trial, report)
        if until in rungs(config):
            decide(folder, config, until)


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


def _give_up(folder: SweepFolder, trial: Trial, error: Exception) -> None:
    message = f"its worker died {TRIES} times: {type(error).__name__}: {error}"
    folder.set_state(trial, folder.state(trial).model_copy(update={"status": "failed", "error": message}))
