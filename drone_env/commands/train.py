"""`drone-env train`: train a network to fly a task."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import tyro
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from drone_env.commands.arguments import TASK, ProfileName
from drone_env.core.rewards import DEFAULT_PROFILE, REWARD_PROFILES
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import data_folder
from drone_env.installer import program
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
FRESH = ("--fresh", "--no-fresh")


class Figures(TextColumn):
    """Text that a narrow terminal cuts off at its end: what stands beside it keeps its width."""

    def render(self, task: Task) -> Text:
        """The figures in one line."""
        text = super().render(task)
        text.no_wrap, text.overflow = True, "ellipsis"
        return text


class Live(Progress):
    """The progress of a training, read again for every frame.

    Args:
        trainer: What is trained.
        console: Where it is shown; nothing is, if that is no terminal.
        clock: Gives the time in seconds.
    """

    def __init__(self, trainer: "Learner", console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._trainer = trainer
        shown = console.file.isatty()
        # By the speed of the last minutes: episodes end in bursts, and a validation takes its time.
        super().__init__(*COLUMNS, console=console, disable=not shown, get_time=clock, speed_estimate_period=300)
        self.bar = self.add_task(trainer.name, total=trainer.wanted, completed=trainer.done, figures="")

    def get_renderables(self) -> Iterable[RenderableType]:
        """One line, which counts what is done up to now."""
        for bar in self.task_ids:  # none yet while this is made
            self.update(bar, completed=self._trainer.done)
        return super().get_renderables()


COLUMNS = (
    TextColumn("{task.description}"),
    MofNCompleteColumn(table_column=Column(no_wrap=True)),
    TimeRemainingColumn(table_column=Column(no_wrap=True)),
    BarColumn(bar_width=8),
    Figures("{task.fields[figures]}", table_column=Column()),
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


def train_commands(arguments: Sequence[str], typed: Sequence[str]) -> Iterator[Callable[..., int]]:
    """The subcommand for each training, its defaults being those of what the arguments name.

    Args:
        arguments: Of the subcommand.
        typed: The same as they were typed, with the files that are now named.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if there is no such preset, no such number of episodes, or no one network for all tasks.
    """
    named = _named(arguments)
    if named.network == "tournet":
        yield _tour_command(_tour_defaults(named.task or "all", named), _going_on(typed))
        return
    if named.task == "all":
        raise InvalidValueError(
            "PathQNet learns one task at a time; --task all is for tournet.\n"
            "Type --task standard (easy, medium, hard), or add --network tournet."
        )
    if named.task != "standard":
        yield _train_command(_defaults(named.task or "easy", named), _going_on(typed))
        return
    for task in STANDARD:
        # With --fresh, the tasks that follow have not started again: the command goes on with this one alone.
        only = {"standard": task, "--task=standard": f"--task={task}"} if named.fresh else {}
        yield _train_command(_defaults(task, named), _going_on([only.get(word, word) for word in typed]))


def _going_on(typed: Sequence[str]) -> str:
    """The command that goes on with a training: as typed, without `--fresh`."""
    script = Path(sys.argv[0]).name == "train.py"
    start = [program("python"), sys.argv[0]] if script else [program("drone-env"), "train"]
    return shlex.join([*start, *(word for word in typed if word not in FRESH)])


def _train_command(defaults: Settings, going_on: str) -> Callable[..., int]:
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
            fresh: Start again; an earlier training is kept as `TASK.pth.1`, `TASK.pth.2` and so on.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        with needs("train"):
            from drone_env.rl.trainer import Trainer
        return _train(lambda: Trainer(config), going_on, resume, fresh, data, results)

    return train


train = _train_command(Settings(**vars(preset("fast", "easy"))), "")
"""The subcommand as the overview of all commands shows it."""


def _tour_command(defaults: TourSettings, going_on: str) -> Callable[..., int]:
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
            fresh: Start again; an earlier training is kept as `tournet.pth.1`, `tournet.pth.2` and so on.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        with needs("train"):
            from drone_env.rl.tour_rewards import RewardTrainer
            from drone_env.rl.tour_trainer import TourTrainer
        make = RewardTrainer if config.kind == "rewards" else TourTrainer
        return _train(lambda: make(config), going_on, resume, fresh, data, results)

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


def _train(
    make: "Callable[[], Learner]", going_on: str, resume: bool, fresh: bool, data: Path | None, results: Path | None
) -> int:
    from drone_env.rl.run import TrainingRun

    if resume and fresh:
        raise InvalidValueError("--resume goes on and --fresh starts again: give one of them")
    run = TrainingRun(make(), data or data_folder(), results or data_folder("results"), fresh)
    if resume and not run.resumed:
        raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}; omit --resume to start")
    trainer, unit, console = run.trainer, run.trainer.unit, Console(stderr=True)
    wanted, begun = trainer.wanted, trainer.done
    if begun >= wanted:
        console.print(
            f"{run.checkpoint} has {begun} of {wanted} {unit}: nothing to do.\n"
            f"{trainer.how_to_go_on}Add --fresh to start again; the old training is kept.",
            soft_wrap=True,
        )
        return 0
    if run.resumed:
        console.print(f"going on from {run.checkpoint}: {begun} of {wanted} {unit}")
    with Live(trainer, console) as progress, run.stopping_on_interrupt():
        clock, work = progress.get_time, trainer.worked
        started = clock()
        for line in run.train():
            rate = (getattr(line, trainer.work) - work) / max(clock() - started, 1e-9)
            figures = f"{trainer.figures(line)}  {rate:.0f} {trainer.work}/s"
            progress.update(progress.bar, figures=figures)
            if not console.file.isatty() and trainer.done % trainer.validation_every == 0:
                print(f"{trainer.done}/{wanted} {unit}  {figures}", file=sys.stderr, flush=True)
    if run.stopped:
        console.print(f"stopped after {trainer.done} {unit}, saved as {run.checkpoint}", soft_wrap=True)
        console.print(f"to go on, type: {going_on}", soft_wrap=True)
        return 130
    done = f"trained: {trainer.result} on the validation maps; network {run.network}, curves {run.results}"
    console.print(done, soft_wrap=True)
    judge = f"{program('drone-env')} evaluate {trainer.judged_by} --checkpoint {run.network}"
    console.print(f"next: {judge}", soft_wrap=True)
    return 0
