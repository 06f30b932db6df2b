"""`drone-env sweep`: train under several settings and seeds, and say which setting is worth what."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from drone_env.commands.arguments import TaskName
from drone_env.errors import InvalidValueError, MissingPackageError
from drone_env.files import data_folder
from drone_env.results.tables import number

Whole = Annotated[int | None, tyro.conf.arg(metavar="N")]
Values = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="set", metavar="NAME=VALUE,VALUE...")]


def sweep(
    task: TaskName = "easy",
    preset: Literal["fast", "original"] = "fast",
    values: Values = (),
    seeds: int = 3,
    samples: Whole = None,
    samples_seed: int = 0,
    early_stopping: bool = True,
    test_maps: int = 1000,
    out: Path | None = None,
    resume: bool = False,
    retry_failed: bool = False,
    dry_run: bool = False,
    max_concurrent: Whole = None,
    cpus_per_trial: int = 1,
    cpus: Whole = None,
    address: str = "local",
    checkpoint_seconds: float = 30.0,
) -> int:
    """Train a network under each of several settings with several seeds, side by side on Ray.

    The same command goes on with a sweep that was interrupted or killed: what is finished is not trained again, the
    rest goes on from its checkpoints. The report stands in `OUT/report.md`. Exit status: 0 if every trial was finished
    or stopped early, 1 if one failed, 2 if something else is wrong.

    Example: drone-env sweep --task easy --seeds 5 --set lr=1e-3,3e-4 --set batch_size=64,128 --out runs/sweep

    Args:
        task: The task, by its short name, id or grader.
        preset: The values that are not set.
        values: A value of training (`drone-env train --help` has them all) and what to try for it; may be given several
            times, for a grid. With --samples also `lr=loguniform(1e-5,1e-3)` or `gamma=uniform(0.9,0.99)`.
        seeds: Each setting is trained with the seeds from 0 up to this number.
        samples: Draw this many settings at random instead of trying the whole grid.
        samples_seed: Of the drawing.
        early_stopping: Stop the worse half of the settings, each with all its seeds, at a quarter and at half of the
            episodes.
        test_maps: How many test maps each finished network flies.
        out: The folder of the sweep; on a cluster, where all machines see it. If nothing is said, sweep/ in
            DRONE_ENV_DATA, and runs/sweep without that.
        resume: Insist that there is a sweep to go on with.
        retry_failed: Go on with the trials that failed, too.
        dry_run: List the trials and train nothing.
        max_concurrent: How many trials train side by side at most; as many as there are CPUs for if nothing is said.
        cpus_per_trial: Threads of each trial.
        cpus: CPUs to use of this machine; all if nothing is said.
        address: The Ray cluster: `local` for this machine alone, `auto` or HOST:PORT for one that runs.
        checkpoint_seconds: Seconds between two checkpoints of a trial.
    """
    from drone_env.cluster.sweep.config import make_config
    from drone_env.cluster.sweep.folder import CONFIG, SweepFolder
    from drone_env.cluster.sweep.settings import settings_of

    if max_concurrent is not None and max_concurrent < 1:
        raise InvalidValueError(f"--max-concurrent must be 1 or more, got {max_concurrent}")
    settings = settings_of(values, samples, samples_seed)
    config = make_config(task, preset, settings, seeds, cpus_per_trial, early_stopping, test_maps)
    config.training(config.trials()[0], checkpoint_seconds)
    folder = SweepFolder(data_folder("sweep") if out is None else out)
    if resume and not (folder.path / CONFIG).exists():
        raise InvalidValueError(f"--resume: there is no sweep in {folder.path}")
    if dry_run:
        for trial in config.trials():
            print(f"{trial.name}\t{config.label(trial.setting)}\t{config.command(trial)}")
        return 0
    for package, extra in (("torch", "train"), ("tensorboard", "train"), ("matplotlib", "train"), ("ray", "cluster")):
        if find_spec(package) is None:
            raise MissingPackageError(package, extra)
    from drone_env.cluster.connect import connect
    from drone_env.cluster.sweep import driver
    from drone_env.cluster.sweep.report import sweep_report, write_report

    def show(trial: Any, report: dict[str, Any]) -> None:
        if "failed" in report:
            message = f"failed: {report['failed']}"
        else:
            best = number(report["optimum"])
            message = f"{report['episodes']} episodes, validation {report['validation']:.4f} of {best}"
        print(f"{trial.name} ({config.label(trial.setting)}): {message}", file=sys.stderr, flush=True)

    with folder.driving():
        folder.begin(config)
        if retry_failed:
            driver.retry_failed(folder, config)
        if not driver.is_done(folder, config):
            try:
                with connect(address, cpus):
                    driver.drive(folder, config, checkpoint_seconds, max_concurrent, show)
            except KeyboardInterrupt:
                print(f"interrupted; to go on, give the same options with --out {folder.path}", file=sys.stderr)
                raise
        figures = sweep_report(folder, config)
        write_report(folder, figures)
    count = figures["trials_by_status"]
    message = f"{count['finished']} trials finished, {count['stopped']} stopped early, {count['failed']} failed"
    Console(stderr=True).print(f"{message}; report {folder.path / 'report.md'}")
    return 1 if count["failed"] else 0
