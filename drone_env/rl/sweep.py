"""Sweeps: one training under many settings and several seeds, with Optuna.

    sweep.json              what the sweep is; its folder continues the same sweep only
    journal.log             Optuna's journal: the setting, the validation scores and the result of each trial
    trial0/lock             held while a process trains the trial
    trial0/seed0/           the files of one training run
    report.md, report.json, curves.png

A trial is one setting with all its seeds, so pruning never keeps the lucky seeds of a setting and stops the others.
Any number of processes work on a sweep, on all machines that share its folder. A killed process leaves a trial that is
marked as running and whose lock is free: the next process continues it from its checkpoints.
"""

import itertools
import math
import multiprocessing
import re
import sys
import warnings
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, get_type_hints

import matplotlib
import numpy as np
import optuna
from filelock import FileLock, Timeout
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, Trial, TrialState
from optuna.visualization import matplotlib as plots
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from drone_env import __version__
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task, own_rules
from drone_env.envs.registry import load_plugins
from drone_env.errors import InvalidValueError, UnknownNameError, text_of
from drone_env.files import differences, is_begun, locked, read_file, replacing, write_json, write_text
from drone_env.models import Message
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.statistics import SCORES, SHARES, crossed, with_interval
from drone_env.results.tables import markdown_table, number
from drone_env.rl.config import TrainConfig, preset
from drone_env.rl.dqn import Trainer
from drone_env.rl.run import TrainingRun

NOT_SET = ("task", "seed", "num_threads", "gpu", "checkpoint_episodes", "checkpoint_seconds")
"""Values of training that `--set` does not take: other options of the command decide them."""
ALIASES = {"lr": "learning_rate"}
RANGE = re.compile(r"(uniform|loguniform)\(([^,()]+),([^,()]+)\)")
COMPARED = ("episodes", "validation_every", "validation_maps", "log_every")
"""Values that all settings must share for pruning: they decide when a validation score is measured, and how."""
MOST_FILE = 16 << 20
LOCK_SECONDS = 60.0
CHECKPOINT_SECONDS = 30.0
"""Minimum time between two checkpoints of a training."""
NAME = "sweep"


class SweepConfig(Message):
    """Everything that decides the results of a sweep."""

    format: Literal["drone_env/sweep"] = "drone_env/sweep"
    format_version: Literal[1] = 1
    version: str = Field(default=__version__, description="Version of this package.")
    task: str
    task_version: int
    rules: dict[str, str] = Field(description="Digest of the task's rules if the task is not the package's.")
    preset: str
    space: dict[str, str] = Field(description="Optuna's distribution of each value that --set names, as JSON.")
    samples: int | None = Field(ge=1, description="Number of settings to sample; null for the whole grid.")
    seeds: int = Field(ge=1, le=1000, description="Each setting is trained with the seeds 0 to seeds - 1.")
    early_stopping: bool
    test_maps: int = Field(ge=2, le=1_000_000, description="Number of test maps that each finished network flies.")

    @property
    def distributions(self) -> dict[str, BaseDistribution]:
        """What Optuna samples from."""
        return {name: optuna.distributions.json_to_distribution(text) for name, text in self.space.items()}

    @property
    def settings(self) -> list[dict[str, Any]]:
        """The whole grid; for sampled settings, all combinations of the ends of the ranges."""
        axes = [_ends(distribution) for distribution in self.distributions.values()]
        return [dict(zip(self.space, values, strict=True)) for values in itertools.product(*axes)]

    def training(self, setting: Mapping[str, Any], seed: int) -> TrainConfig:
        """Return how a setting is trained with a seed.

        Raises:
            InvalidValueError: if a value is out of range.
        """
        return replace(
            preset(self.preset, self.task, setting.get("episodes")),
            task=get_task(self.task).short_name,
            seed=seed,
            num_threads=1,
            checkpoint_episodes=1,
            checkpoint_seconds=CHECKPOINT_SECONDS,
            **setting,
        )

    def label(self, setting: Mapping[str, Any]) -> str:
        """A setting in words: the values that differ between settings."""
        varied = [name for name, distribution in self.distributions.items() if len(_ends(distribution)) > 1]
        return " ".join(f"{name}={setting[name]}" for name in varied)


def distribution_of(text: str) -> tuple[str, BaseDistribution]:
    """Parse `NAME=VALUE,VALUE...`, `NAME=uniform(LOW,HIGH)` or `NAME=loguniform(LOW,HIGH)`.

    Raises:
        UnknownNameError: if training has no such value.
        InvalidValueError: if the text has another form, or a value is not of the name's type.
    """
    given, equals, listed = (part.strip() for part in text.partition("="))
    name = ALIASES.get(given, given.replace("-", "_"))
    if not equals or not listed:
        raise InvalidValueError(f"--set takes NAME=VALUE,VALUE... such as lr=1e-3,3e-4; got {text!r}")
    hints = get_type_hints(TrainConfig)
    kinds = {field.name: hints[field.name] for field in fields(TrainConfig) if field.name not in NOT_SET}
    if name not in kinds:
        raise UnknownNameError("setting", given, [*kinds, *ALIASES])
    parse = TypeAdapter[Any](kinds[name], config=ConfigDict(allow_inf_nan=False)).validate_strings
    try:
        if found := RANGE.fullmatch("".join(listed.split())):
            low, high, log = parse(found[2]), parse(found[3]), found[1] == "loguniform"
            if kinds[name] is int:
                return name, IntDistribution(low, high, log)
            if kinds[name] is float:
                return name, FloatDistribution(low, high, log)
            raise InvalidValueError("only numbers have ranges: list the values, separated by commas")
        return name, CategoricalDistribution(list(dict.fromkeys(parse(value.strip()) for value in listed.split(","))))
    except ValidationError as error:
        raise InvalidValueError(f"--set {text}: {text_of(error)}") from None
    except ValueError as error:
        raise InvalidValueError(f"--set {text}: {error}") from None


def _ends(distribution: BaseDistribution) -> Sequence[Any]:
    if isinstance(distribution, CategoricalDistribution):
        return distribution.choices
    assert isinstance(distribution, (IntDistribution, FloatDistribution))
    return distribution.low, distribution.high


def make_config(task: str, sets: Sequence[str], samples: int | None, **values: Any) -> SweepConfig:
    """Return the configuration of a sweep whose settings are all valid.

    Args:
        task: The task.
        sets: The texts of `--set`.
        samples: Number of settings to sample; None for the whole grid.
        values: The other fields of `SweepConfig`.

    Raises:
        UnknownNameError: if there is no such task, value of training or reward profile.
        InvalidValueError: if a value is out of range, a name is set twice, a range has no `samples`, or settings cannot
            be compared early.
    """
    space = dict(pairs := [distribution_of(text) for text in sets])
    for i, (name, distribution) in enumerate(pairs):
        if name in dict(pairs[:i]):
            raise InvalidValueError(f"{name} is set twice: name all its values in one --set")
        if samples is None and not isinstance(distribution, CategoricalDistribution):
            raise InvalidValueError(f"{name} is a range: add --samples N, the number of settings to sample")
        if values["early_stopping"] and name in COMPARED and len(_ends(distribution)) > 1:
            raise InvalidValueError(f"settings with different {name} cannot be compared: add --no-early-stopping")
    known = get_task(task)
    try:
        config = SweepConfig(
            task=known.id,
            task_version=known.version,
            rules=own_rules(known),
            space={name: optuna.distributions.distribution_to_json(values) for name, values in space.items()},
            samples=samples,
            **values,
        )
    except ValidationError as error:
        raise InvalidValueError(text_of(error, lambda name: f"--{name.replace('_', '-')}")) from None
    for setting in config.settings:
        config.training(setting, 0)
    return config


def begin(out: Path, config: SweepConfig) -> None:
    """Make the folder of a sweep, or check that it is the folder of this sweep.

    Raises:
        OSError: if it cannot be made or read.
        InvalidValueError: if it contains something else, or a sweep with another configuration.
    """
    if not is_begun(out, "sweep.json", "a sweep"):
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "sweep.json", config.model_dump_json(indent=2) + "\n")
    elif changed := differences(read_config(out).model_dump(mode="json"), config.model_dump(mode="json")):
        raise InvalidValueError(f"the sweep in {out} has another configuration: {'; '.join(changed)}")


def read_config(out: Path) -> SweepConfig:
    """Read what the sweep in a folder is.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if the file is no configuration of a sweep.
    """
    try:
        return SweepConfig.model_validate_json(read_file(out / "sweep.json", MOST_FILE))
    except ValidationError as error:
        raise InvalidValueError(f"{out / 'sweep.json'} is no sweep: {text_of(error)}") from None


def open_study(out: Path, config: SweepConfig) -> optuna.Study:
    """Open Optuna's study of a sweep, which is made if it does not exist yet."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    training = config.training(config.settings[0], 0)
    # Rungs at a ninth and at a third of the episodes.
    pruner = optuna.pruners.HyperbandPruner(max(training.episodes // 9, 1), training.episodes)
    with locked(out / "lock", f"another process holds {out / 'lock'}", LOCK_SECONDS):
        return optuna.create_study(
            storage=optuna.storages.JournalStorage(JournalFileBackend(str(out / "journal.log"))),
            pruner=pruner if config.early_stopping else optuna.pruners.NopPruner(),
            study_name=NAME,
            direction="maximize",
            load_if_exists=True,
        )


def run(out: Path, processes: int) -> None:
    """Train in several processes until no trial is left that another process does not train."""
    if processes == 1:
        _work(out)
        return
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_work_alone, args=(out,)) for _ in range(processes)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()


def _work_alone(out: Path) -> None:
    load_plugins()
    with suppress(KeyboardInterrupt):  # the process that started this one reports it
        _work(out)


def _work(out: Path) -> None:
    """Train one trial after another until none is left."""
    config = read_config(out)
    study = open_study(out, config)
    while (taken := _take(study, config, out)) is not None:
        trial, lock = taken
        try:
            study.tell(trial, _train(trial, config, out))
        except optuna.TrialPruned:
            study.tell(trial, state=TrialState.PRUNED)
        except Exception as error:  # the result of this trial: the others go on
            trial.set_user_attr("error", f"{type(error).__name__}: {error}")
            study.tell(trial, state=TrialState.FAIL)
            _show(config, trial, f"failed: {error}")
        finally:
            lock.release()


def _take(study: optuna.Study, config: SweepConfig, out: Path) -> tuple[Trial, FileLock] | None:
    """Return a trial that no process trains, with its lock held: an abandoned one, else a new one."""
    storage = study._storage  # pyright: ignore[reportPrivateUsage]
    with locked(out / "lock", f"another process holds {out / 'lock'}", LOCK_SECONDS):
        for running in study.get_trials(states=(TrialState.RUNNING,)):
            lock = FileLock(out / f"trial{running.number}" / "lock", timeout=0)
            with suppress(Timeout):
                lock.acquire()
                study_id = storage.get_study_id_from_name(NAME)
                return Trial(study, storage.get_trial_id_from_study_id_trial_number(study_id, running.number)), lock
        begun = len(study.get_trials())
        if begun == (config.samples or len(config.settings)):
            return None
        if config.samples is None:
            study.enqueue_trial(config.settings[begun])
        # Each process has a sampler, and with one seed all would sample the same setting.
        study.sampler = optuna.samplers.TPESampler(seed=begun)
        trial = study.ask(config.distributions)
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
        place = out / f"trial{trial.number}" / f"seed{seed}"
        runs.append(TrainingRun(Trainer(config.training(trial.params, seed)), place, place))
    lines = [run.train() for run in runs]
    training, optimum = runs[0].trainer.config, runs[0].trainer.metadata()["validation_optimum"]
    trial.set_user_attr("validation_optimum", optimum)
    known = trial.study.get_trials()[trial.number].intermediate_values
    every, parent = training.validation_every, multiprocessing.parent_process()
    score, episodes = 0.0, 0
    for validation in range(every, training.episodes + every, every):
        episodes = min(validation, training.episodes)
        score = fmean(_best_until(run, of, episodes) for run, of in zip(runs, lines, strict=True))
        if parent is not None and not parent.is_alive():
            sys.exit("the process that started this one has ended")
        if episodes not in known:
            trial.report(score, episodes)
            _show(config, trial, f"{episodes} episodes, validation {score:.4f} of {number(optimum)}")
            if trial.should_prune():
                break
    pruned = episodes < training.episodes
    for run, rest in zip(runs, lines, strict=True):
        run.stopped = pruned
        deque(rest, maxlen=0)
    if pruned:
        raise optuna.TrialPruned
    trial.set_user_attr("test", _fly_test_maps(runs, config))
    return score


def _best_until(run: TrainingRun, lines: Any, episodes: int) -> float:
    """Train to the first line of the log at or after `episodes`; return the best validation score up to there."""
    history = run.trainer.history
    while not (history and history[-1].episode >= episodes) and next(lines, None) is not None:
        pass
    last = next((i for i, line in enumerate(history) if line.episode >= episodes), len(history))
    return max((line.validation for line in history[: last + 1] if not math.isnan(line.validation)), default=0.0)


def _fly_test_maps(runs: list[TrainingRun], config: SweepConfig) -> dict[str, Any]:
    """Return the best networks' scores on the test maps beside the optimum; intervals are (mean, low, high)."""
    seeds = split_seeds("test", config.test_maps)
    flown = [run_episodes(episodes_key(config.task, f"pathqnet:{run.network}", seeds, "test")) for run in runs]
    scores, optima = np.array([results.scores for results in flown]), flown[0].optimal_scores
    optimum, ratio = None, None
    if not np.isnan(optima).any():
        optimum = float(optima.mean())
        share = scores.mean() / optimum
        # Linearised: what a map adds to mean score / mean optimum, which hard maps lower in both.
        ratio = crossed(share + (scores - share * optima) / optimum, SHARES)
    return {
        "score": crossed(scores, SCORES),
        "optimum": optimum,
        "ratio": ratio,
        "seed_scores": scores.mean(axis=1).tolist(),
    }


def _show(config: SweepConfig, trial: Trial, message: str) -> None:
    print(f"trial{trial.number} ({config.label(trial.params)}): {message}", file=sys.stderr, flush=True)


def write_report(out: Path, config: SweepConfig) -> Counter[str]:
    """Write the report and the plots of a sweep; return the number of trials in each state."""
    study = open_study(out, config)
    rows = [_row(trial) for trial in study.get_trials()]
    rows.sort(key=lambda row: (row["state"] != "complete", -(row["validation"] or 0)))
    report = {"format": "drone_env/sweep-report", "config": config.model_dump(mode="json"), "trials": rows}
    write_json(out / "report.json", report)
    head = ("trial", "setting", "state", "episodes", "validation", "test score", "of the optimum", "each seed")
    table = [
        (
            f"{row['trial']}",
            config.label(row["setting"]),
            row["error"] or row["state"],
            f"{row['episodes']}",
            f"{number(row['validation'])} of {number(row['validation_optimum'])}",
            _figure(row["test"] and row["test"]["score"]),
            _figure(row["test"] and row["test"]["ratio"]),
            " ".join(map(number, row["test"]["seed_scores"])) if row["test"] else "-",
        )
        for row in rows
    ]
    text = (
        f"# Sweep of {config.task}, preset {config.preset}\n\nEach setting is trained with {config.seeds} seeds. Test "
        f"scores are means over {config.test_maps:,} test maps, with 95 % intervals over seeds and maps.\n\n"
        f"{markdown_table(head, table)}\n\n![validation scores](curves.png)\n"
    )
    write_text(out / "report.md", text)
    _draw(study, next((row["validation_optimum"] for row in rows if row["validation_optimum"]), None), out)
    return Counter(row["state"] for row in rows)


def _figure(figure: Sequence[float] | None) -> str:
    return "-" if figure is None else with_interval(figure[0], figure[1:])


def _row(trial: FrozenTrial) -> dict[str, Any]:
    return {
        "trial": trial.number,
        "setting": trial.params,
        "state": "failed" if trial.state == TrialState.FAIL else trial.state.name.lower(),
        "episodes": trial.last_step or 0,
        "validation": trial.intermediate_values.get(trial.last_step or 0),
        "validation_optimum": None,
        "test": None,
        "error": None,
        **trial.user_attrs,
    }


def _draw(study: optuna.Study, optimum: float | None, out: Path) -> None:
    matplotlib.use("Agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        axes = plots.plot_intermediate_values(study)
    if optimum is not None:
        axes.axhline(optimum, color="black", linestyle="dotted", label="optimum")
        axes.legend()
    axes.set_ylabel("validation score")
    figure = axes.get_figure(root=True)
    assert figure is not None
    with replacing(out / "curves.png") as temporary:
        figure.savefig(temporary, format="png")
