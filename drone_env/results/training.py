"""Histories of training runs, grouped by their settings, with statistics over seeds as in rliable.

A run is a folder with two files. `config.toml` contains `algorithm`, `task`, `seed` and any other settings.
`history.csv` contains one line per entry of the log, with the columns `validation` (mean score on the validation maps),
`validation_optimum` (the mean optimum of these maps) and at least one that grows, such as `cpu_seconds` or `steps`. A
network for several tasks has a column of shares of the optimum for each, such as `validation_easy`.
"""

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.files import read_file
from drone_env.results.statistics import Floats, iqm_interval
from drone_env.toml_text import parse_toml

CONFIG, HISTORY = "config.toml", "history.csv"
MAX_CONFIG, MAX_HISTORY = 1 << 16, 1 << 26
NO_TASKS = ("validation_optimum", "validation_sampled")
"""Columns that begin like those of single tasks."""
SAME_RUN = ("seed", "num_threads", "checkpoint_seconds", "checkpoint_episodes")
"""Settings in which the runs of a group may differ."""
SCORE = " (score)"
"""Ends the name of a task whose optimum is unknown."""
POINTS = 200
"""Maximum number of points of a curve."""


@dataclass(frozen=True)
class Curve:
    """The history of one run on one task.

    Attributes:
        algorithm: The algorithm.
        task: The task; it ends in `SCORE` if the optimum is unknown.
        seed: The seed.
        settings: The other settings.
        columns: The columns of the history.
        ratios: The share of the optimum at the last validation before each line; the score if the optimum is unknown.
    """

    algorithm: str
    task: str
    seed: int
    settings: dict[str, Any]
    columns: dict[str, Floats]
    ratios: Floats


@dataclass(frozen=True)
class Group:
    """Curves whose settings differ only in their seeds.

    Attributes:
        label: The algorithm, and the settings in which it differs from other groups of it on this task.
        task: The task.
        curves: The curves.
    """

    label: str
    task: str
    curves: list[Curve]

    @property
    def finals(self) -> Floats:
        """The last value of each curve, float64[seeds, 1]."""
        return np.array([curve.ratios[-1:] for curve in self.curves])

    def over(self, column: str) -> tuple[Floats, Floats, Floats, Floats]:
        """The interquartile mean along a column: its values, means, lower and upper ends of the intervals.

        Between two lines a run keeps its value, and after its last line too.

        Raises:
            UnknownNameError: if a history does not have the column.
        """
        for curve in self.curves:
            if column not in curve.columns:
                raise UnknownNameError(f"column of {self.label} on {self.task}", column, curve.columns)
        lines = [curve.columns[column] for curve in self.curves]
        values = np.unique(np.concatenate(lines))
        values = values[values >= max(line[0] for line in lines)]
        values = values[np.unique(np.linspace(0, len(values) - 1, POINTS).astype(int))]
        at = [np.searchsorted(line, values, side="right") - 1 for line in lines]
        return values, *iqm_interval([np.array([c.ratios[i] for c, i in zip(self.curves, at, strict=True)])], 2_000)


def read_runs(folders: Iterable[Path]) -> tuple[list[Curve], list[str]]:
    """Read all training runs in these folders; return their curves, and what is left out with the reason."""
    curves, left_out, seen = list[Curve](), list[str](), set[Path]()
    for folder in folders:
        runs = {file.parent for name in (CONFIG, HISTORY) for file in folder.rglob(name)}
        if not runs:
            left_out.append(f"{folder}: no {CONFIG} and {HISTORY} in it")
        for run in sorted(runs):
            try:
                if run.resolve() not in seen:
                    curves += _read_run(run)
            except (OSError, ValueError) as error:
                left_out.append(f"{run}: {getattr(error, 'strerror', None) or error}")
            seen.add(run.resolve())
    return curves, left_out


def _read_run(folder: Path) -> list[Curve]:
    for name in (CONFIG, HISTORY):
        if not (folder / name).is_file():
            raise InvalidValueError(f"no {name} in it")
    settings = parse_toml(read_file(folder / CONFIG, MAX_CONFIG))
    rows = list(csv.reader(read_file(folder / HISTORY, MAX_HISTORY).decode().splitlines()))
    if len({len(row) for row in rows}) != 1:
        raise InvalidValueError(f"{HISTORY} is empty, or its lines differ in length")
    head, lines = rows[0], np.array(rows[1:], np.float64)
    missing = [name for name in ("algorithm", "task", "seed") if name not in settings]
    missing += [name for name in ("validation", "validation_optimum") if name not in head]
    if missing:
        raise InvalidValueError(f"it lacks {', '.join(missing)}")
    if not len(lines) or np.isnan(lines[-1, head.index("validation")]):
        raise InvalidValueError("no validation yet")
    lines = lines[~np.isnan(lines[:, head.index("validation")])]
    columns = dict(zip(head, lines.T, strict=True))
    done, total = int(lines[-1, 0]), settings.get(head[0], settings.get(f"{head[0]}s", 0))
    if done < total:
        raise InvalidValueError(f"unfinished: {done:,} of {total:,} {head[0].removesuffix('s')}s")
    prefix, optimum, task = "validation_", columns["validation_optimum"], _short_name(settings.pop("task"))
    tasks = [name for name in head if name.startswith(prefix) and name not in NO_TASKS]
    ratios = {name.removeprefix(prefix): columns[name] for name in tasks}
    if not tasks and np.isnan(optimum).any():
        ratios = {task + SCORE: columns["validation"]}
    elif not tasks:
        ratios = {task: columns["validation"] / optimum}
    algorithm, seed = settings.pop("algorithm"), settings.pop("seed")
    rest = {name: value for name, value in settings.items() if name not in SAME_RUN}
    return [Curve(algorithm, name, seed, rest, columns, ratio) for name, ratio in ratios.items()]


def _short_name(task: str) -> str:
    try:
        return get_task(task).short_name
    except UnknownNameError:
        return Path(task).stem  # of a city file, or of a module that is not loaded


def group_curves(curves: Iterable[Curve]) -> list[Group]:
    """Group curves by task and settings. Labels name the settings that differ between groups of one task."""
    groups: dict[tuple[str, str], dict[str, dict[int, Curve]]] = {}
    for curve in curves:
        variants = groups.setdefault((curve.task, curve.algorithm), {})
        variants.setdefault(json.dumps(curve.settings, sort_keys=True, default=str), {})[curve.seed] = curve
    found: list[Group] = []
    for (task, algorithm), variants in groups.items():
        settings = [next(iter(seeds.values())).settings for seeds in variants.values()]
        names = sorted({name for each in settings for name in each})
        differing = [name for name in names if any(each.get(name) != settings[0].get(name) for each in settings)]
        for seeds, each in zip(variants.values(), settings, strict=True):
            label = ", ".join([algorithm, *(f"{name}={each[name]}" for name in differing if name in each)])
            found.append(Group(label, task, list(seeds.values())))
    tasks = [*(task.short_name for task in TASKS.values()), *(group.task for group in found)]
    return sorted(found, key=lambda group: tasks.index(group.task))
