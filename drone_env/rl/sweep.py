"""Sweeps: one training under many settings and several seeds, with Optuna.

    journal.log             Optuna's journal: the configuration, and setting, scores and result of each trial
    trial0/lock             held while a process trains the trial
    trial0/seed0/           the files of one training run
    report.md

A trial is one setting with all its seeds, so pruning never keeps the lucky seeds of a setting and stops the others.
Any number of processes work on a sweep, on all machines that share its folder. A killed process leaves a trial that is
marked as running and whose lock is free: the next process continues it from its checkpoints.
"""

import itertools
import math
import multiprocessing
import sys
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, get_type_hints

import numpy as np
import optuna
from filelock import FileLock, Timeout
from optuna.distributions import CategoricalDistribution
from optuna.storages.journal import JournalFileBackend
from optuna.trial import Trial, TrialState
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.envs.registry import load_plugins
from drone_env.errors import InvalidValueError, UnknownNameError, text_of
from drone_env.files import differences, is_begun, locked, write_text
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.statistics import SCORES, crossed, with_interval
from drone_env.results.tables import markdown_table, number
from drone_env.rl.config import TrainConfig, check_values, preset
from drone_env.rl.dqn import Trainer
from drone_env.rl.run import TrainingRun

NOT_SET = ("task", "seed", "num_threads", "gpu", "checkpoint_episodes", "checkpoint_seconds")
"""Settings of training that `--set` does not take: other options of the command decide them."""
ALIASES = {"lr": "learning_rate"}
COMPARED = ("episodes", "validation_every", "validation_maps", "log_every")
"""Settings that all trials must share for pruning: they decide when and how validation scores are measured."""
LOCK_SECONDS = 60.0
CHECKPOINT_SECONDS = 30.0
"""Minimum time between two checkpoints of a training."""
NAME = "sweep"


@dataclass(frozen=True)
class SweepConfig:
    """Everything that decides the results of a sweep.

    Raises:
        UnknownNameError: if there is no such task or reward profile.
        InvalidValueError: if a value is out of range, or settings cannot be compared early.
    """

    task: str
    preset: str
    space: dict[str, list[Any]]
    """The values of each setting; several make a grid."""
    seeds: Annotated[int, Field(ge=1, le=1000)]
    """Each setting is trained with the seeds 0 to seeds - 1."""
    early_stopping: bool
    test_maps: Annotated[int, Field(ge=2, le=1_000_000)]
    """Number of test maps that each finished network flies."""

    def __post_init__(self) -> None:
        check_values(self)
        for name, values in self.space.items():
            if self.early_stopping and name in COMPARED and len(values) > 1:
                raise InvalidValueError(f"settings with different {name} cannot be compared: add --no-early-stopping")
        for setting in self.settings:
            self.training(setting, 0)

    @property
    def settings(self) -> list[dict[str, Any]]:
        """The grid."""
        return [dict(zip(self.space, values, strict=True)) for values in itertools.product(*self.space.values())]

    def training(self, setting: Mapping[str, Any], seed: int) -> TrainConfig:
        """The training of a setting with a seed."""
        return replace(
            preset(self.preset, self.task, setting.get("episodes")),
            seed=seed,
            num_threads=1,
            checkpoint_episodes=1,
            checkpoint_seconds=CHECKPOINT_SECONDS,
            **setting,
        )

    def identity(self) -> dict[str, Any]:
        """The configuration as JSON values, with the task's rules."""
        return self.training({}, 0).identity() | vars(self) | {"task": get_task(self.task).id}

    def label(self, setting: Mapping[str, Any]) -> str:
        """A setting in words: the values that differ between settings."""
        return " ".join(f"{name}={setting[name]}" for name, values in self.space.items() if len(values) > 1)


def values_of(text: str) -> tuple[str, list[Any]]:
    """Parse `NAME=VALUE,VALUE...`.

    Raises:
        UnknownNameError: if training has no such setting.
        InvalidValueError: if the text has another form, or a value is not of the setting's type.
    """
    given, _, values = (part.strip() for part in text.partition("="))
    if not values:
        raise InvalidValueError(f"--set takes NAME=VALUE,VALUE... such as lr=1e-3,3e-4; got {text!r}")
    name = ALIASES.get(given, given.replace("-", "_"))
    hints = get_type_hints(TrainConfig)
    types = {field.name: hints[field.name] for field in fields(TrainConfig) if field.name not in NOT_SET}
    if name not in types:
        raise UnknownNameError("setting", given, [*types, *ALIASES])
    parse = TypeAdapter[Any](types[name], config=ConfigDict(allow_inf_nan=False)).validate_strings
    try:
        return name, list(dict.fromkeys(parse(value.strip()) for value in values.split(",")))
    except ValidationError as error:
        raise InvalidValueError(f"--set {text}: {text_of(error)}") from None


def open_study(out: Path, config: SweepConfig) -> optuna.Study:
    """Open Optuna's study of a sweep; make it if it does not exist.

    Raises:
        OSError: if its folder cannot be written.
        InvalidValueError: if the folder contains something else, or a sweep with another configuration.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    is_begun(out, "journal.log", "a sweep")
    out.mkdir(parents=True, exist_ok=True)
    # Rungs at a ninth and at a third of the episodes.
    episodes = config.training(config.settings[0], 0).episodes
    pruner = optuna.pruners.HyperbandPruner(max(episodes // 9, 1), episodes)
    with locked(out / "lock", f"another process holds {out / 'lock'}", LOCK_SECONDS):
        study = optuna.create_study(
            storage=optuna.storages.JournalStorage(JournalFileBackend(str(out / "journal.log"))),
            pruner=pruner if config.early_stopping else optuna.pruners.NopPruner(),
            study_name=NAME,
            direction="maximize",
            load_if_exists=True,
        )
        if "config" not in study.user_attrs:
            study.set_user_attr("config", config.identity())
    if changed := differences(study.user_attrs["config"], config.identity()):
        raise InvalidValueError(f"the sweep in {out} has another configuration: {'; '.join(changed)}")
    return study


def run(out: Path, config: SweepConfig, processes: int) -> None:
    """Train in several processes until no trial is left that another process does not train."""
    open_study(out, config)
    if processes == 1:
        _work(out, config)
        return
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_work_in_process, args=(out, config)) for _ in range(processes)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()


def _work_in_process(out: Path, config: SweepConfig) -> None:
    load_plugins()
    with suppress(KeyboardInterrupt):  # the parent process reports it
        _work(out, config)


def _work(out: Path, config: SweepConfig) -> None:
    """Train one trial after another until none is left."""
    study = open_study(out, config)
    while (taken := _take(study, config, out)) is not None:
        trial, lock = taken
        try:
            study.tell(trial, _train(trial, config, out))
        except optuna.TrialPruned:
            study.tell(trial, state=TrialState.PRUNED)
        except Exception as error:  # it is the result of this trial; the others continue
            trial.set_user_attr("error", f"{type(error).__name__}: {error}")
            study.tell(trial, state=TrialState.FAIL)
            _show(config, trial, f"failed: {error}")
        finally:
            lock.release()


def _take(study: optuna.Study, config: SweepConfig, out: Path) -> tuple[Trial, FileLock] | None:
    """A trial that no process trains, with its lock held: an abandoned one, else a new one."""
    storage = study._storage  # pyright: ignore[reportPrivateUsage]
    with locked(out / "lock", f"another process holds {out / 'lock'}", LOCK_SECONDS):
        for running in study.get_trials(states=(TrialState.RUNNING,)):
            lock = FileLock(out / f"trial{running.number}" / "lock", timeout=0)
            with suppress(Timeout):
                lock.acquire()
                study_id = storage.get_study_id_from_name(NAME)
                return Trial(study, storage.get_trial_id_from_study_id_trial_number(study_id, running.number)), lock
        begun = len(study.get_trials())
        if begun == len(config.settings):
            return None
        study.enqueue_trial(config.settings[begun])
        trial = study.ask({name: CategoricalDistribution(values) for name, values in config.space.items()})
        folder = out / f"trial{trial.number}"
        folder.mkdir(exist_ok=True)
        lock = FileLock(folder / "lock", timeout=0)
        lock.acquire()
        return trial, lock


def _train(trial: Trial, config: SweepConfig, out: Path) -> float:
    """Train a setting with all its seeds side by side; return its mean validation score.

    Raises:
        TrialPruned: if it is stopped early.
    """
    runs: list[TrainingRun] = []
    for seed in range(config.seeds):
        folder = out / f"trial{trial.number}" / f"seed{seed}"
        runs.append(TrainingRun(Trainer(config.training(trial.params, seed)), folder, folder))
    logs = [run.train() for run in runs]
    training, optimum = runs[0].trainer.config, runs[0].trainer.metadata()["validation_optimum"]
    trial.set_user_attr("validation_optimum", optimum)
    reported = trial.study.get_trials()[trial.number].intermediate_values
    every, parent = training.validation_every, multiprocessing.parent_process()
    score, episodes = 0.0, 0
    for validation in range(every, training.episodes + every, every):
        episodes = min(validation, training.episodes)
        score = fmean(_best_until(run, log, episodes) for run, log in zip(runs, logs, strict=True))
        if parent is not None and not parent.is_alive():
            sys.exit("the parent process has ended")
        if episodes not in reported:
            trial.report(score, episodes)
            _show(config, trial, f"{episodes} episodes, validation {score:.4f} of {number(optimum)}")
            if trial.should_prune():
                break
    pruned = episodes < training.episodes
    for run, rest in zip(runs, logs, strict=True):
        run.stopped = pruned
        deque(rest, maxlen=0)
    if pruned:
        raise optuna.TrialPruned
    trial.set_user_attr("test", _fly_test_maps(runs, config))
    return score


def _best_until(run: TrainingRun, log: Any, episodes: int) -> float:
    """Train to the first line of the log at or after `episodes`; return the best validation score up to there."""
    history = run.trainer.history
    while not (history and history[-1].episode >= episodes) and next(log, None) is not None:
        pass
    last = next((i for i, line in enumerate(history) if line.episode >= episodes), len(history))
    return max((line.validation for line in history[: last + 1] if not math.isnan(line.validation)), default=0.0)


def _fly_test_maps(runs: list[TrainingRun], config: SweepConfig) -> dict[str, Any]:
    """The best networks' scores on the test maps: all as (mean, low, high), and the mean of each seed."""
    seeds = split_seeds("test", config.test_maps)
    results = [run_episodes(episodes_key(config.task, f"pathqnet:{run.network}", seeds, "test")) for run in runs]
    scores = np.array([result.scores for result in results])
    return {"score": crossed(scores, SCORES), "seed_scores": scores.mean(axis=1).tolist()}


def _show(config: SweepConfig, trial: Trial, message: str) -> None:
    print(f"trial{trial.number} ({config.label(trial.params)}): {message}", file=sys.stderr, flush=True)


def write_report(out: Path, config: SweepConfig) -> Counter[TrialState]:
    """Write the report of a sweep; return the number of trials in each state."""
    trials = open_study(out, config).get_trials()
    trials.sort(key=lambda trial: (trial.state != TrialState.COMPLETE, -(trial.value or 0)))
    head = ("trial", "setting", "state", "episodes", "validation", "test score", "each seed")
    rows: list[tuple[str, ...]] = []
    for trial in trials:
        test = trial.user_attrs.get("test")
        validation = trial.intermediate_values.get(trial.last_step or 0)
        rows.append(
            (
                f"{trial.number}",
                config.label(trial.params),
                trial.user_attrs.get("error", trial.state.name.lower()),
                f"{trial.last_step or 0}",
                f"{number(validation)} of {number(trial.user_attrs.get('validation_optimum'))}",
                with_interval(test["score"][0], test["score"][1:]) if test else "-",
                " ".join(map(number, test["seed_scores"])) if test else "-",
            )
        )
    text = (
        f"# Sweep of {get_task(config.task).id}, preset {config.preset}\n\nEach setting is trained with {config.seeds} "
        f"seeds. Test scores are means over {config.test_maps:,} test maps, with 95 % intervals over seeds and "
        f"maps.\n\n{markdown_table(head, rows)}\n"
    )
    write_text(out / "report.md", text)
    return Counter(trial.state for trial in trials)
