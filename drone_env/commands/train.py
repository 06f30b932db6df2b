"""`drone-env train`: train a network to fly a task."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drone_env.errors import InvalidValueError, MissingPackageError, UnknownNameError

if TYPE_CHECKING:
    from drone_env.rl.run import Run

COLUMNS = (
    TextColumn("{task.description}"),
    BarColumn(),
    MofNCompleteColumn(),
    TextColumn("{task.fields[figures]}"),
    TimeRemainingColumn(),
)


def train_command(arguments: Sequence[str]) -> Callable[..., int]:
    """The subcommand, its defaults being those of the preset and the task that stand in the arguments."""
    if "train" not in arguments[:1]:
        # Others need not know the hyperparameters, nor wait for them to be loaded.
        return _described
    from drone_env.rl.config import PRESETS, TrainConfig, preset

    chosen, task = _value_of("--preset", arguments) or "fast", _value_of("--task", arguments) or "easy"
    try:
        defaults = preset(chosen, task)
    except (InvalidValueError, UnknownNameError):
        defaults = preset("fast", "easy")  # tyro or TrainConfig says what is wrong with the arguments

    def train(
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = defaults,
        preset: Literal["fast", "original"] = "fast",
        resume: bool = False,
        fresh: bool = False,
        data: Path = Path("data"),
        results: Path = Path("results"),
    ) -> int:
        """Train a network to fly a task, and judge it against the exact optimum while it learns.

        Goes on from `data/TASK.pth` if that is there; Ctrl-C saves it and ends. Next to it stands the best network by
        validation, `data/TASK.npz`: `drone-env evaluate --agents pathqnet --checkpoint data/TASK.npz`.

        The defaults below are those of the preset for the task. `original` has the hyperparameters of the first
        version of this project, `fast` those that were found to learn fastest.

        Example: drone-env train --task hard

        Args:
            config: How to train.
            preset: Which defaults to start from.
            resume: Insist that there is a checkpoint to go on from.
            fresh: Start anew; a checkpoint that is there is renamed to `TASK.pth.old`.
            data: Folder of checkpoint, network and log.
            results: Folder of tables and curves.
        """
        if resume and fresh:
            raise InvalidValueError("--resume goes on and --fresh starts anew: give one of them")
        run = _run(config, data, results, fresh)
        if resume and not run.resumed:
            raise InvalidValueError(f"--resume: there is no checkpoint {run.checkpoint}")
        return _train(run)

    assert set(PRESETS) == {"fast", "original"}
    return train


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
    trainer, console = run.trainer, Console(stderr=True)
    wanted, begun = run.config.episodes, trainer.episodes
    if trainer.episodes >= wanted:
        console.print(
            f"{run.checkpoint} has {trainer.episodes} episodes already: ask for more with --episodes, or --fresh"
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
                f"{rate:.0f} steps/s  epsilon {line.epsilon:.2f}  loss {line.loss:.5f}  "
                f"validation {line.validation:.4f} of {line.validation_optimum:.4f}"
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
