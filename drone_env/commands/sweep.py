"""`drone-env sweep`: train under several settings and seeds, and compare the settings."""

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from drone_env.commands.arguments import TaskName
from drone_env.errors import InvalidValueError, needs
from drone_env.files import data_folder

Values = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="set", metavar="NAME=VALUE,VALUE...")]


def sweep(
    task: TaskName = "easy",
    preset: Literal["fast", "original"] = "fast",
    values: Values = (),
    seeds: int = 3,
    early_stopping: bool = True,
    test_maps: int = 1000,
    out: Path | None = None,
    processes: int = os.cpu_count() or 1,
    dry_run: bool = False,
) -> int:
    """Train a network under several settings with several seeds each, with Optuna.

    Repeat the command to continue an interrupted sweep, or to join a running one from a machine that shares the folder.
    The report is `OUT/report.md`. Exit status: 0 if every trial finished or was stopped early, 1 if one failed or is
    unfinished, 2 for other errors.

    Example: drone-env sweep --task easy --seeds 5 --set lr=1e-3,3e-4 --set batch_size=64,128 --out runs/sweep

    Args:
        task: The task, by its short name, id or grader.
        preset: The preset of all other settings.
        values: A setting of training (`drone-env train --help` lists all) and its values. Several make a grid.
        seeds: Number of seeds that each setting is trained with.
        early_stopping: Stop settings with low validation scores early (Hyperband).
        test_maps: Number of test maps that each finished network flies.
        out: The folder of the sweep. The default is sweep/ in DRONE_ENV_DATA, or runs/sweep without that.
        processes: Number of trials at a time on this machine; the default is its number of CPUs.
        dry_run: List the settings and train nothing.
    """
    with needs("train"):
        from optuna.trial import TrialState

        from drone_env.rl import sweep as sweeps
    pairs = [sweeps.values_of(text) for text in values]
    space = dict(pairs)
    if len(space) < len(pairs):
        raise InvalidValueError("a setting is set twice: list all its values in one --set")
    config = sweeps.SweepConfig(task, preset, space, seeds, early_stopping, test_maps)
    if dry_run:
        print(f"{len(config.settings)} settings with {seeds} seeds each")
        for setting in config.settings:
            print(config.label(setting))
        return 0
    folder = data_folder("sweep") if out is None else out
    try:
        sweeps.run(folder, config, processes)
    except KeyboardInterrupt:
        print(f"interrupted; to continue, repeat the command with --out {folder}", file=sys.stderr)
        raise
    count = sweeps.write_report(folder, config)
    states = {"finished": TrialState.COMPLETE, "stopped early": TrialState.PRUNED, "failed": TrialState.FAIL}
    parts = ", ".join(f"{count[state]} {name}" for name, state in states.items())
    unfinished = count[TrialState.RUNNING]
    more = f", {unfinished} unfinished: repeat the command to continue" if unfinished else ""
    print(f"trials: {parts}{more}; report {folder / 'report.md'}", file=sys.stderr)
    return 1 if count[TrialState.FAIL] or unfinished else 0
