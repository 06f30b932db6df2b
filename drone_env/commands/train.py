"""`drone-env train`: train a network to fly a task."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drone_env.commands.arguments import TASK, ProfileName
from drone_env.core.rewards import DEFAULT_PROFILE, REWARD_PROFILES
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import data_folder
from drone_env.rl.config import TrainConfig, preset
from drone_env.rl.tour_config import TourConfig

if TYPE_CHECKING:
    from drone_env.rl.learner import Learner

STANDARD = ("easy", "medium", "hard")
"""The tasks of `--task standard`."""
TaskOrAll = Annotated[str, tyro.conf.arg(metavar=f"{TASK}|all")]
TaskOrStandard = Annotated[str, tyro.conf.arg(metavar=f"{TASK}|standard")]
Network = Literal["pathqnet", "tournet"]
CHOSEN = ("task", "kind")
"""What a checkpoint is found by, and so no setting that is taken from it."""

COLUMNS = (
    TextColumn("{task.description}"),
    BarColumn(),
    MofNCompleteColumn(),
    TextColumn("{task.fields[figures]}"),
    TimeRemainingColumn(),
)


@dataclass(frozen=True)
class Settings(TrainConfig):
    """How to train the task that the command names, or each of those."""

    task: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "easy"
    reward_profile: ProfileName = DEFAULT_PROFILE
    """What steps pay: a reward profile, or a TOML file with one. Its shaping, if it has one, is set to `gamma`."""


@dataclass(frozen=True)
class TourSettings(TourConfig):
    """How to train one network for the task that the command names, or for all."""

    task: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "all"


AnySettings = TypeVar("AnySettings", Settings, TourSettings)


def train_commands(arguments: Sequence[str]) -> Iterator[Callable[..., int]]:
    """The subcommand for each training, its defaults being those of what the arguments name.

    Args:
        arguments: Of the command line; those of another subcommand name nothing.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if there is no such preset, no such number of episodes, or no one network for all tasks.
    """
    named = _named(arguments if arguments[:1] == ["train"] else [])
    if named.network == "tournet":
        yield _tour_command(_tour_defaults(named.task or "all", named))
        return
    if named.task == "all":
        raise InvalidValueError(
            "PathQNet learns one task at a time; --task all is for tournet.\n"
            "Type --task standard (easy, medium, hard), or add --network tournet."
        )
    for task in STANDARD if named.task == "standard" else [named.task or "easy"]:
        yield _train_command(_defaults(task, named))


def _train_command(defaults: Settings) -> Callable[..., int]:
    def train(
        config: Annotated[Settings, tyro.conf.arg(name="")] = defaults,
        network: Network = "pathqnet",
        task: TaskOrStandard = "easy",
        preset: Literal["fast", "original"] = "fast",
        resume: bool = False,
        fresh: bool = False,
        data: Path | None = None,
        results: Path | None = None,
    ) -> int:
        """Train a network to fly a task, and judge it against the exact optimum while it learns.

        Goes on from `data/TASK.pth` if that is there, with its settings; Ctrl-C saves it and ends. Next to it stands
        the best network by validation, `data/TASK.npz`: `drone-env serve` in the same folder flies it, and so does
        `drone-env evaluate --agents pathqnet --checkpoint data/TASK.npz`.

        The defaults below are those of the preset for the task and the number of episodes. `original` has the
        hyperparameters of the first version of this project, `fast` those that were found to learn fastest. With
        `--network tournet` there are others: `drone-env train --network tournet --help`.

        Example: drone-env train --task hard

        Args:
            config: How to train.
            network: What to train: `pathqnet` learns the values of actions on one task from its rewards, `tournet`
                learns which parcel or pad to fly to next from exact values, on all tasks at once.
            task: The task, by its short name, id or grader; `standard` for easy, medium and hard, one after another.
            preset: Which defaults to start from.
            resume: Insist that there is a checkpoint to go on from.
            fresh: Start again; a checkpoint that is there is renamed to `TASK.pth.old`.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        with needs("train"):
            from drone_env.rl.trainer import Trainer
        return _train(lambda: Trainer(config), resume, fresh, data, results)

    return train


def _tour_command(defaults: TourSettings) -> Callable[..., int]:
    def train(
        config: Annotated[TourSettings, tyro.conf.arg(name="")] = defaults,
        network: Network = "tournet",
        task: TaskOrAll = "all",
        resume: bool = False,
        fresh: bool = False,
        data: Path | None = None,
        results: Path | None = None,
    ) -> int:
        """Train a tour network, and judge it against the exact optimum while it learns.

        It is distilled: it learns from the exact value of each option (`drone_env.planning.legs`), on maps of the train
        split. Goes on from `data/tournet.pth` if that is there, with its settings; Ctrl-C saves it and ends. Next to it
        stands the network, `data/tournet.npz`: `drone-env evaluate --agents tournet --checkpoint data/tournet.npz`
        flies it. A network for one task is `tournet_TASK` instead of `tournet`.

        Example: drone-env train --network tournet --task all

        Args:
            config: How to train.
            network: What to train: `tournet`.
            task: `all` for one network that flies every registered task, or one task.
            resume: Insist that there is a checkpoint to go on from.
            fresh: Start again; a checkpoint that is there is renamed to `tournet.pth.old`.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        with needs("train"):
            from drone_env.rl.tour_rewards import RewardTrainer
            from drone_env.rl.tour_trainer import TourTrainer
        make = RewardTrainer if config.kind == "rewards" else TourTrainer
        return _train(lambda: make(config), resume, fresh, data, results)

    return train


def _named(arguments: Sequence[str]) -> argparse.Namespace:
    """What the defaults depend on. Whatever is wrong with it, tyro says."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for flag in ("--network", "--task", "--kind", "--preset", "--episodes", "--data"):
        parser.add_argument(flag, nargs="?")
    parser.add_argument("--fresh", action=argparse.BooleanOptionalAction)
    return parser.parse_known_args(arguments)[0]


def _defaults(task: str, named: argparse.Namespace) -> Settings:
    episodes = int(named.episodes) if named.episodes and named.episodes.isdecimal() else None
    defaults = Settings(**vars(preset(named.preset or "fast", task, episodes)))
    # How many fly side by side follows from how many were asked for at first, which is forgotten by now.
    return defaults if named.preset else _as_before(defaults, get_task(task).short_name, named)


def _tour_defaults(task: str, named: argparse.Namespace) -> TourSettings:
    defaults = TourSettings(task=task, kind="rewards" if named.kind == "rewards" else "distilled")
    return _as_before(defaults, defaults.name, named)


def _as_before(defaults: AnySettings, name: str, named: argparse.Namespace) -> AnySettings:
    """The settings of the checkpoint that the training will go on from, where there is one."""
    checkpoint = Path(named.data or data_folder()) / f"{name}.pth"
    if named.fresh or not checkpoint.exists():
        return defaults
    try:
        from drone_env.rl.checkpoint import load_checkpoint

        kept = load_checkpoint(checkpoint)["config"]
        passed = {*CHOSEN, *({"reward_profile"} if kept.get("reward_profile") not in REWARD_PROFILES else ())}
        names = [field.name for field in fields(defaults) if field.name in kept and field.name not in passed]
        return type(defaults)(**vars(defaults) | {name: kept[name] for name in names})
    except (CheckpointError, OSError, ModuleNotFoundError, KeyError, TypeError, InvalidValueError):
        return defaults  # `TrainingRun` says what is wrong with it, or what is missing


def _train(make: "Callable[[], Learner]", resume: bool, fresh: bool, data: Path | None, results: Path | None) -> int:
    from drone_env.rl.run import TrainingRun

    if resume and fresh:
        raise InvalidValueError("--resume goes on and --fresh starts again: give one of them")
    run = TrainingRun(make(), data or data_folder(), results or data_folder("results"), fresh)
    if resume and not run.resumed:
        raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}")
    trainer, unit, console = run.trainer, run.trainer.unit, Console(stderr=True)
    wanted, begun = trainer.wanted, trainer.done
    if begun >= wanted:
        console.print(
            f"{run.checkpoint} has {begun} {unit} already, and {wanted} were asked for: nothing to do. "
            f"{trainer.how_to_go_on}--fresh starts again and keeps it as {run.checkpoint}.old",
            soft_wrap=True,
        )
        return 0
    if run.resumed:
        console.print(f"going on from {run.checkpoint}: {begun} of {wanted} {unit}")
    bars = Progress(*COLUMNS, console=console, disable=not console.file.isatty())
    with bars as progress, run.stopping_on_interrupt():
        bar = progress.add_task(trainer.name, total=wanted, completed=begun, figures="")
        clock, work = progress.get_time, trainer.worked
        started = clock()
        for line in run.train():
            rate = (getattr(line, trainer.work) - work) / max(clock() - started, 1e-9)
            figures = f"{rate:.0f} {trainer.work}/s  {trainer.figures(line)}"
            progress.update(bar, completed=trainer.done, figures=figures)
            if not console.file.isatty() and trainer.done % trainer.validation_every == 0:
                print(f"{trainer.done}/{wanted} {unit}  {figures}", file=sys.stderr, flush=True)
    if run.stopped:
        console.print(
            f"stopped after {trainer.done} {unit}; the same command goes on from {run.checkpoint}", soft_wrap=True
        )
        return 130
    done = f"trained: {trainer.result} on the validation maps; network {run.network}, curves {run.results}"
    console.print(done, soft_wrap=True)
    console.print(f"next: drone-env evaluate {trainer.judged_by} --checkpoint {run.network}", soft_wrap=True)
    return 0
