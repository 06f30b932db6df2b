"""`drone-env train`: train a network to fly a task."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, MissingPackageError, UnknownNameError
from drone_env.files import data_folder

if TYPE_CHECKING:
    from drone_env.rl.config import TrainConfig
    from drone_env.rl.run import Run

ALL = ("easy", "medium", "hard")
"""What `--task all` stands for."""

COLUMNS = (
    TextColumn("{task.description}"),
    BarColumn(),
    MofNCompleteColumn(),
    TextColumn("{task.fields[figures]}"),
    TimeRemainingColumn(),
)


def one_by_one(arguments: Sequence[str]) -> list[Sequence[str]]:
    """The arguments of each training, one for each task where they say `train --task all`; else as they are."""
    if "train" not in arguments[:1] or _value_of("--task", arguments) != "all":
        return [arguments]
    return [
        [
            f"--task={task}" if it == "--task=all" else task if before == "--task" else it
            for before, it in zip(["", *arguments], arguments, strict=False)
        ]
        for task in ALL
    ]


def train_command(arguments: Sequence[str]) -> Callable[..., int]:
    """The subcommand, its defaults being those of the preset, task, episodes and checkpoint that the arguments name."""
    if "train" not in arguments[:1]:
        # Others need not know the hyperparameters, nor wait for them to be loaded.
        return _described
    from drone_env.rl.config import PRESETS, TrainConfig

    defaults = _defaults(arguments)

    def train(
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = defaults,
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
        `--task all` trains easy, medium and hard, one after the other.

        Example: drone-env train --task hard

        Args:
            config: How to train.
            preset: Which defaults to start from.
            resume: Insist that there is a checkpoint to go on from.
            fresh: Start anew; a checkpoint that is there is renamed to `TASK.pth.old`.
            data: Folder of checkpoint, network and log; DRONE_ENV_DATA if nothing is said, else data.
            results: Folder of tables and curves; results/ in DRONE_ENV_DATA if nothing is said, else results.
        """
        if resume and fresh:
            raise InvalidValueError("--resume goes on and --fresh starts anew: give one of them")
        run = _run(config, data or data_folder(), results or data_folder("results"), fresh)
        if resume and not run.resumed:
            raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}")
        return _train(run)

    assert set(PRESETS) == {"fast", "original"}
    return train


def _defaults(arguments: Sequence[str]) -> "TrainConfig":
    from drone_env.rl.config import preset

    chosen, task, episodes = (_value_of(flag, arguments) for flag in ("--preset", "--task", "--episodes"))
    try:
        number = int(episodes) if episodes and episodes.isdecimal() else None
        defaults = preset(chosen or "fast", task or "easy", number)
    except (InvalidValueError, UnknownNameError):
        return preset("fast", "easy")  # tyro or TrainConfig says what is wrong with the arguments
    checkpoint = Path(_value_of("--data", arguments) or data_folder()) / f"{get_task(defaults.task).short_name}.pth"
    if chosen or "--fresh" in arguments or not checkpoint.exists():
        return defaults
    # How many fly side by side follows from how many were asked for at first, which is forgotten by now.
    try:
        from drone_env.rl.checkpoint import load_checkpoint

        kept = load_checkpoint(checkpoint)["config"]
        names = [field.name for field in fields(defaults) if field.name != "task" and field.name in kept]
        return replace(defaults, **{name: kept[name] for name in names})
    except (CheckpointError, OSError, ModuleNotFoundError, KeyError, TypeError, InvalidValueError):
        return defaults  # `Run` says what is wrong with it, or what is missing


def _described() -> int:
    """Train a network to fly a task, and judge it against the exact optimum while it learns."""
    raise AssertionError("replaced by train_command where it is called")


_described.__name__ = "train"


def _run(config: Any, data: Path, results: Path, fresh: bool) -> "Run":
    try:
        from drone_env.rl.run import Run
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise MissingPackageError("PyTorch", "train") from None
    return Run(config, data, results, fresh)


def _train(run: "Run") -> int:
    from drone_env.rl.run import figure

    trainer, console = run.trainer, Console(stderr=True)
    wanted, begun = run.config.episodes, trainer.episodes
    if trainer.episodes >= wanted:
        console.print(
            f"{run.checkpoint} has {trainer.episodes} episodes already, and {wanted} were asked for: nothing to do. "
            f"--episodes {2 * trainer.episodes} goes on from it; --fresh starts anew and keeps it as "
            f"{run.checkpoint}.old",
            soft_wrap=True,
        )
        return 0
    if run.resumed:
        console.print(f"going on from {run.checkpoint}: {begun} of {wanted} episodes")
    with Progress(*COLUMNS, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(trainer.task.short_name, total=wanted, completed=begun, figures="")
        clock, steps = progress.get_time, trainer.steps
        started = clock()

        def show(line: Any) -> None:
            rate = (line.steps - steps) / max(clock() - started, 1e-9)
            figures = (
                f"{rate:.0f} steps/s  epsilon {line.epsilon:.2f}  loss {figure(line.loss, 5)}  "
                f"validation {figure(line.validation, 4)} of {line.validation_optimum:.4f}"
            )
            progress.update(bar, completed=line.episode, figures=figures)
            if not console.is_terminal and line.episode % run.config.validation_every == 0:
                print(f"{line.episode}/{wanted} episodes  {figures}", file=sys.stderr, flush=True)

        run.train(show)
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


def _value_of(flag: str, arguments: Sequence[str]) -> str | None:
    """What stands behind a flag, None where it is not given."""
    for argument, following in zip(arguments, [*arguments[1:], ""], strict=True):
        if argument == flag:
            return following
        if argument.startswith(f"{flag}="):
            return argument.removeprefix(f"{flag}=")
    return None
