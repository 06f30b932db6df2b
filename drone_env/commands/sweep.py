"""`drone-env sweep`: train under several settings and seeds, and compare the settings."""

import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from drone_env.commands.arguments import TaskName
from drone_env.errors import needs
from drone_env.files import data_folder

Whole = Annotated[int | None, tyro.conf.arg(metavar="N")]
Values = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="set", metavar="NAME=VALUE,VALUE...")]


def sweep(
    task: TaskName = "easy",
    preset: Literal["fast", "original"] = "fast",
    values: Values = (),
    seeds: int = 3,
    samples: Whole = None,
    early_stopping: bool = True,
    test_maps: int = 1000,
    out: Path | None = None,
    dry_run: bool = False,
    processes: int = os.cpu_count() or 1,
) -> int:
    """Train a network under each of several settings with several seeds, with Optuna.

    The same command continues a sweep that was interrupted or killed, and joins one that runs, also from another
    machine that shares the folder. The report is `OUT/report.md`. Exit status: 0 if every trial was finished or stopped
    early, 1 if one failed or is unfinished, 2 if something else is wrong.

    Example: drone-env sweep --task easy --seeds 5 --set lr=1e-3,3e-4 --set batch_size=64,128 --out runs/sweep

    Args:
        task: The task, by its short name, id or grader.
        preset: The values that are not set.
        values: A value of training (`drone-env train --help` lists all) and what to try for it. Several make a grid.
            With --samples also `lr=loguniform(1e-5,1e-3)` or `gamma=uniform(0.9,0.99)`.
        seeds: Each setting is trained with the seeds from 0 up to this number.
        samples: Sample this many settings (Optuna's TPE) instead of trying the whole grid.
        early_stopping: Stop settings whose validation scores fall behind (Hyperband).
        test_maps: How many test maps each finished network flies.
        out: The folder of the sweep. The default is sweep/ in DRONE_ENV_DATA, or runs/sweep without that.
        dry_run: List the trials and train nothing.
        processes: Trials at a time on this machine; by default as many as its CPUs allow.
    """
    with needs("train"):
        from drone_env.rl import sweep as sweeps
    config = sweeps.make_config(
        task,
        values,
        preset=preset,
        samples=samples,
        seeds=seeds,
        early_stopping=early_stopping,
        test_maps=test_maps,
    )
    folder = data_folder("sweep") if out is None else out
    if dry_run:
        if samples is not None:
            print(f"{samples} settings with {seeds} seeds each, sampled from: {' '.join(values)}")
        for number, setting in enumerate(config.settings if samples is None else ()):
            for seed in range(seeds):
                print(f"trial{number}/seed{seed}\t{config.label(setting)}")
        return 0
    sweeps.begin(folder, config)
    try:
        sweeps.run(folder, processes)
    except KeyboardInterrupt:
        print(f"interrupted; to continue, repeat the command with --out {folder}", file=sys.stderr)
        raise
    count = sweeps.write_report(folder, config)
    parts = [f"{count['complete']} trials finished", f"{count['pruned']} stopped early", f"{count['failed']} failed"]
    parts += [f"{count['running']} unfinished: repeat the command to continue"] * (count["running"] > 0)
    print(f"{', '.join(parts)}; report {folder / 'report.md'}", file=sys.stderr)
    return 1 if count["failed"] or count["running"] else 0
