"""`drone-env train`: train a network to fly a task."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drone_env.commands.arguments import SHORT_NAMES
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, needs
from drone_env.files import data_folder
from drone_env.rl.config import TrainConfig, preset

if TYPE_CHECKING:
    from drone_env.rl.run import TrainingRun

ALL = ("easy", "medium", "hard")
"""What `--task all` stands for."""
TaskOrAll = Annotated[str, tyro.conf.arg(metavar="|".join([*SHORT_NAMES, "all"]))]

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


def train_commands(arguments: Sequence[str]) -> Iterator[Callable[..., int]]:
    """The subcommand for each task to train, its defaults being those of what the arguments name.

    Args:
        arguments: Of the command line; those of another subcommand name nothing.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if there is no such preset, or no such number of episodes.
    """
    named = _named(arguments if arguments[:1] == ["train"] else [])
    for task in ALL if named.task == "all" else [named.task or "easy"]:
        yield _train_command(_defaults(task, named))


def _train_command(defaults: Settings) -> Callable[..., int]:
    def train(
        config: Annotated[Settings, tyro.conf.arg(name="")] = defaults,
        task: TaskOrAll = "easy",
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
        hyperparameters of the first version of this project, `fast` those that were found to learn fastest.

        Example: drone-env train --task hard

        Args:
            config: How to train.
            task: The task, by its short name, id or grader; `all` for easy, medium and hard, one after the other.
            preset: Which defaults to start from.
            resume: Insist that there is a checkpoint to go on from.
            fresh: Start again; a checkpoint that is there is renamed to `TASK.pth.old`.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        if resume and fresh:
            raise InvalidValueError("--resume goes on and --fresh starts again: give one of them")
        with needs("train"):
            from drone_env.rl.run import TrainingRun
        run = TrainingRun(config, data or data_folder(), results or data_folder("results"), fresh)
        if resume and not run.resumed:
            raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}")
        return _train(run)

    return train


def _named(arguments: Sequence[str]) -> argparse.Namespace:
    """What the defaults depend on. Whatever is wrong with it, tyro says."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for flag in ("--task", "--preset", "--episodes", "--data"):
        parser.add_argument(flag, nargs="?")
    parser.add_argument("--fresh", action=argparse.BooleanOptionalAction)
    return parser.parse_known_args(arguments)[0]


def _defaults(task: str, named: argparse.Namespace) -> Settings:
    episodes = int(named.episodes) if named.episodes and named.episodes.isdecimal() else None
    defaults = vars(preset(named.preset or "fast", task, episodes))
    checkpoint = Path(named.data or data_folder()) / f"{get_task(task).short_name}.pth"
    if named.preset or named.fresh or not checkpoint.exists():
        return Settings(**defaults)
    # How many fly side by side follows from how many were asked for at first, which is forgotten by now.
    try:
        from drone_env.rl.checkpoint import load_checkpoint

        kept = load_checkpoint(checkpoint)["config"]
        names = [field.name for field in fields(TrainConfig) if field.name != "task" and field.name in kept]
        return Settings(**defaults | {name: kept[name] for name in names})
    except (CheckpointError, OSError, ModuleNotFoundError, KeyError, TypeError, InvalidValueError):
        return Settings(**defaults)  # `TrainingRun` says what is wrong with it, or what is missing


def _train(run: "TrainingRun") -> int:
    from drone_env.rl.run import figure

    trainer, console = run.trainer, Console(stderr=True)
    wanted, begun = run.config.episodes, trainer.episodes
    if trainer.episodes >= wanted:
        console.print(
            f"{run.checkpoint} has {trainer.episodes} episodes already, and {wanted} were asked for: nothing to do. "
            f"--episodes {2 * trainer.episodes} goes on from it; --fresh starts again and keeps it as "
            f"{run.checkpoint}.old",
            soft_wrap=True,
        )
        return 0
    if run.resumed:
        console.print(f"going on from {run.checkpoint}: {begun} of {wanted} episodes")
    bars = Progress(*COLUMNS, console=console, disable=not console.is_terminal)
    with bars as progress, run.stopping_on_interrupt():
        bar = progress.add_task(trainer.task.short_name, total=wanted, completed=begun, figures="")
        clock, steps = progress.get_time, trainer.steps
        started = clock()
        for line in run.train():
            rate = (line.steps - steps) / max(clock() - started, 1e-9)
            figures = (
                f"{rate:.0f} steps/s  epsilon {line.epsilon:.2f}  loss {figure(line.loss, 5)}  "
                f"validation {figure(line.validation, 4)} of {line.validation_optimum:.4f}"
            )
            progress.update(bar, completed=line.episode, figures=figures)
            if not console.is_terminal and line.episode % run.config.validation_every == 0:
                print(f"{line.episode}/{wanted} episodes  {figures}", file=sys.stderr, flush=True)
    if run.stopped:
        console.print(f"stopped after {trainer.episodes} episodes; the same command goes on from {run.checkpoint}")
        return 130
    console.print(
        f"trained: {trainer.best_score:.4f} of {trainer.validator.optimum:.4f} on the validation maps; "
        f"network {run.network}, curves {run.results}"
    )
    console.print(
        f"next: drone-env evaluate --task {trainer.task.short_name} --agents greedy pathqnet --checkpoint {run.network}"
    )
    return 0
