"""`drone-env train`: train a network to fly a task."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tyro
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from drone_env.commands.arguments import TASK, ProfileName
from drone_env.core.rewards import DEFAULT_PROFILE, REWARD_PROFILES
from drone_env.core.tasks import get_task
from drone_env.envs.registry import task_argument
from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import data_folder
from drone_env.installer import program
from drone_env.rl.config import TrainConfig, preset
from drone_env.rl.tour_config import TourConfig

if TYPE_CHECKING:
    from drone_env.rl.run import TrainingRun

STANDARD = ("easy", "medium", "hard")
"""The tasks of `--task standard`."""
TaskOrAll = Annotated[str, tyro.conf.arg(metavar=f"{TASK}|all")]
TaskOrStandard = Annotated[str, tyro.conf.arg(metavar=f"{TASK}|standard")]
Network = Literal["pathqnet", "tournet"]
CHOSEN = ("task", "kind")
"""Settings that find the checkpoint, and so are not taken from it."""
FRESH = ("--fresh", "--no-fresh")


class Figures(TextColumn):
    """Text that a narrow terminal cuts off at its end."""

    def render(self, task: Task) -> Text:
        """The figures in one line."""
        text = super().render(task)
        text.no_wrap, text.overflow = True, "ellipsis"
        return text


class Live(Progress):
    """The progress bar of a training, updated for every frame.

    Args:
        run: The training.
        console: The terminal; the bar is hidden if it is none.
        clock: Returns the time in seconds.
    """

    def __init__(self, run: "TrainingRun[Any]", console: Console, clock: Callable[[], float] = time.monotonic) -> None:
        self._run = run
        hidden = not console.file.isatty()
        # The speed of the last minutes: episodes end in bursts, and validations take time.
        super().__init__(*COLUMNS, console=console, disable=hidden, get_time=clock, speed_estimate_period=300)
        self.bar = self.add_task(run.name, total=run.total, completed=run.done, figures="")

    def get_renderables(self) -> Iterable[RenderableType]:
        """The line of the bar, with the current count."""
        for bar in self.task_ids:  # empty during construction
            self.update(bar, completed=self._run.done)
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
    """The settings for the task that the command names, or for each of those."""

    task: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "easy"
    reward_profile: ProfileName = DEFAULT_PROFILE
    """Reward profile, or a TOML file with one. Potential-based shaping, if the profile has it, uses `gamma`."""


@dataclass(frozen=True)
class TourSettings(TourConfig):
    """The settings for the task that the command names, or for one network on all tasks."""

    task: tyro.conf.Suppress[tyro.conf.Fixed[str]] = "all"


AnySettings = TypeVar("AnySettings", Settings, TourSettings)


def train_commands(arguments: Sequence[str], typed: Sequence[str]) -> Iterator[Callable[..., int]]:
    """The subcommand for each training, with the defaults of its preset or checkpoint.

    Args:
        arguments: The arguments of the subcommand.
        typed: The same as typed, with the names of files.

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
        # With --fresh, the next tasks have not started again: the command continues this one alone.
        only = {"standard": task, "--task=standard": f"--task={task}"} if named.fresh else {}
        yield _train_command(_defaults(task, named), _going_on([only.get(word, word) for word in typed]))


def _going_on(typed: Sequence[str]) -> str:
    """The command that continues a training: as typed, without `--fresh`."""
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
        """Train a network to fly a task, and validate it against the exact optimum.

        Continues from `data/TASK.pth` if it exists, with its settings; Ctrl-C saves and ends. The best network by
        validation is `data/TASK.safetensors`: `drone-env serve` in the same folder flies it, and so does
        `drone-env evaluate --agents pathqnet --checkpoint data/TASK.safetensors`.

        The defaults below are those of the preset for the task and the number of episodes. `original` has the
        hyperparameters of the first version of this project, `fast` learns fastest. `--network tournet` has other
        settings: `drone-env train --network tournet --help`.

        Example: drone-env train --task hard

        Args:
            config: The settings.
            network: The network: `pathqnet` learns the values of actions on one task from rewards, `tournet` learns
                which parcel or pad to fly to next from exact values, on all tasks at once.
            task: The task, by its short name, id or grader; `standard` for easy, medium and hard, one after another.
            preset: The preset of the defaults.
            resume: Fail if there is no checkpoint.
            fresh: Start from scratch; an earlier training is kept as `TASK.pth.1`, `TASK.pth.2` and so on.
            data: Folder of checkpoint, network and log; the default is DRONE_ENV_DATA, else data.
            results: Folder of tables and curves; the default is results/ in DRONE_ENV_DATA, else results.
        """
        with needs("train"):
            from drone_env.rl.dqn import Trainer
        return _train(lambda: Trainer(config), going_on, resume, fresh, data, results)

    return train


train = _train_command(Settings(**vars(preset("fast", "easy"))), "")
"""The subcommand in the overview of all commands."""


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
        """Train a tour network, and validate it against the exact optimum.

        It learns from the exact value of each option (`drone_env.planning.legs`), on maps of the train split. Continues
        from `data/tournet.pth` if it exists, with its settings; Ctrl-C saves and ends. The network is
        `data/tournet.safetensors`; to fly it, type `drone-env evaluate --agents tournet --checkpoint
        data/tournet.safetensors`. A network for one task is `tournet_TASK` instead of `tournet`.

        Example: drone-env train --network tournet --task all

        Args:
            config: The settings.
            network: The network: `tournet`.
            task: `all` for one network that flies every registered task, or one task.
            resume: Fail if there is no checkpoint.
            fresh: Start from scratch; an earlier training is kept as `tournet.pth.1`, `tournet.pth.2` and so on.
            data: Folder of checkpoint, network and log; the default is DRONE_ENV_DATA, else data.
            results: Folder of tables and curves; the default is results/ in DRONE_ENV_DATA, else results.
        """
        with needs("train"):
            from drone_env.rl.tour_rewards import RewardTrainer
            from drone_env.rl.tournet import TourTrainer
        make = RewardTrainer if config.kind == "rewards" else TourTrainer
        return _train(lambda: make(config), going_on, resume, fresh, data, results)

    return train


def _named(arguments: Sequence[str]) -> argparse.Namespace:
    """The arguments that the defaults depend on; tyro reports their errors."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for flag in ("--network", "--task", "--kind", "--preset", "--episodes", "--data"):
        parser.add_argument(flag, nargs="?")
    parser.add_argument("--fresh", action=argparse.BooleanOptionalAction)
    return parser.parse_known_args(arguments)[0]


def _defaults(task: str, named: argparse.Namespace) -> Settings:
    episodes = int(named.episodes) if named.episodes and named.episodes.isdecimal() else None
    defaults = Settings(**vars(preset(named.preset or "fast", task, episodes)))
    # The number of environments depends on the first number of episodes, which only the checkpoint has.
    return defaults if named.preset else _as_before(defaults, get_task(task).short_name, named)


def _tour_defaults(task: str, named: argparse.Namespace) -> TourSettings:
    defaults = TourSettings(task=task, kind="rewards" if named.kind == "rewards" else "distilled")
    return _as_before(defaults, defaults.name, named)


def _as_before(defaults: AnySettings, name: str, named: argparse.Namespace) -> AnySettings:
    """The settings of the checkpoint, if there is one."""
    checkpoint = Path(named.data or data_folder()) / f"{name}.pth"
    if named.fresh or not checkpoint.exists():
        return defaults
    try:
        from drone_env.rl.run import load_checkpoint

        kept = load_checkpoint(checkpoint)["config"]
        passed = {*CHOSEN, *({"reward_profile"} if kept.get("reward_profile") not in REWARD_PROFILES else ())}
        names = [field.name for field in fields(defaults) if field.name in kept and field.name not in passed]
        return type(defaults)(**vars(defaults) | {name: kept[name] for name in names})
    except (CheckpointError, OSError, ModuleNotFoundError, KeyError, TypeError, InvalidValueError):
        return defaults  # `TrainingRun` reports the error


def _train(
    make: Callable[[], Any], going_on: str, resume: bool, fresh: bool, data: Path | None, results: Path | None
) -> int:
    from drone_env.rl.run import TrainingRun, summary

    if resume and fresh:
        raise InvalidValueError("--resume goes on and --fresh starts again: give one of them")
    run = TrainingRun(make(), data or data_folder(), results or data_folder("results"), fresh)
    if resume and not run.resumed:
        raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}; omit --resume to start")
    unit, total, begun, console = run.unit, run.total, run.done, Console(stderr=True)
    is_dqn = unit == "episodes"
    if begun >= total:
        more = f"Add --episodes {2 * begun} to go on. " if is_dqn else ""
        console.print(
            f"{run.checkpoint} has {begun} of {total} {unit}: nothing to do.\n"
            f"{more}Add --fresh to start again; the old training is kept.",
            soft_wrap=True,
        )
        return 0
    if run.resumed:
        console.print(f"going on from {run.checkpoint}: {begun} of {total} {unit}")
    with Live(run, console) as progress, run.stopping_on_interrupt():
        clock, work = progress.get_time, "steps" if is_dqn else "states"
        started, before = clock(), getattr(run.trainer, work)
        for line in run.train():
            rate = (getattr(line, work) - before) / max(clock() - started, 1e-9)
            figures = f"{summary(line)}  {rate:.0f} {work}/s"
            progress.update(progress.bar, figures=figures)
            if not console.file.isatty() and run.done % run.trainer.config.validation_every == 0:
                print(f"{run.done}/{total} {unit}  {figures}", file=sys.stderr, flush=True)
    if run.stopped:
        console.print(f"stopped after {run.done} {unit}, saved as {run.checkpoint}", soft_wrap=True)
        console.print(f"to go on, type: {going_on}", soft_wrap=True)
        return 130
    done = f"trained: {run.trainer.result} on the validation maps; network {run.network}, curves {run.results}"
    console.print(done, soft_wrap=True)
    task = run.trainer.config.task
    task, agent = task if task == "all" else task_argument(get_task(task)), "pathqnet" if is_dqn else "tournet"
    evaluate = f"{program('drone-env')} evaluate --task {task} --agents greedy {agent} --checkpoint {run.network}"
    console.print(f"next: {evaluate}", soft_wrap=True)
    return 0
