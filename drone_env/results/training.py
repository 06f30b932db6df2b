"""Histories of training runs, grouped by their settings, with statistics over seeds as in rliable.

A run is a folder with two files. `config.toml` contains `algorithm`, `task`, `seed` and any other settings.
`history.csv` contains a line for each entry of the log, with the columns `validation` (mean score on the validation
maps), `validation_optimum` (mean optimum of these maps) and at least one that grows, such as `cpu_seconds`. A network
for several tasks has a column of shares of the optimum for each, such as `validation_easy`.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.statistics import Floats, iqm_interval
from drone_env.toml_text import parse_toml

PREFIX = "validation_"
NO_TASKS = ("validation_optimum", "validation_sampled")
"""Columns that begin like those of single tasks."""
SAME_RUN = ("num_threads", "checkpoint_seconds", "checkpoint_episodes")
"""Settings in which the runs of a group may differ, beside the seed."""
POINTS = 200
"""Maximum number of points of a curve."""


class Curve(NamedTuple):
    """One run on one task: the columns of its history, and the share of the optimum at the last validation before."""

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
        label: The algorithm, and the settings in which it differs from its other groups on this task.
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
        """The values of a column, and interquartile means with the ends of their intervals.

        Between two lines a run keeps its value, and after its last line too.

        Raises:
            UnknownNameError: if a history does not have the column.
        """
        if missing := [curve.columns for curve in self.curves if column not in curve.columns]:
            raise UnknownNameError(f"column of {self.label} on {self.task}", column, missing[0])
        lines = [curve.columns[column] for curve in self.curves]
        values = np.unique(np.concatenate(lines))
        values = values[values >= max(line[0] for line in lines)]
        values = values[np.unique(np.linspace(0, len(values) - 1, POINTS).astype(int))]
        at = [np.searchsorted(line, values, side="right") - 1 for line in lines]
        return values, *iqm_interval([np.array([c.ratios[i] for c, i in zip(self.curves, at, strict=True)])], 2_000)


def read_runs(folders: Iterable[Path]) -> tuple[list[Curve], list[str]]:
    """Read all training runs in these folders; return their curves, and what is left out with the reason."""
    curves, left_out = list[Curve](), list[str]()
    for folder in folders:
        runs = sorted(file.parent for file in folder.rglob("config.toml"))
        for run in runs:
            try:
                curves += _read_run(run)
            except KeyError as error:
                left_out.append(f"{run}: {error} is missing")
            except (OSError, ValueError) as error:
                left_out.append(f"{run}: {error}")
    return curves, left_out


def _read_run(folder: Path) -> list[Curve]:
    settings = parse_toml((folder / "config.toml").read_bytes())
    algorithm, task, seed = (settings.pop(name) for name in ("algorithm", "task", "seed"))
    task = TASKS[task].short_name if task in TASKS else Path(task).stem
    head, *lines = (folder / "history.csv").read_text("utf-8").splitlines() or [""]
    columns = dict(zip(head.split(","), np.loadtxt(lines, delimiter=",", ndmin=2).T, strict=True)) if lines else {}
    known = ~np.isnan(columns["validation"]) if lines else np.zeros(0, np.bool_)
    if not known.any():
        raise InvalidValueError("no validation yet")
    columns = {name: column[known] for name, column in columns.items()}
    unit = next(iter(columns))
    done, total = int(columns[unit][-1]), settings.get(unit, settings.get(f"{unit}s", 0))
    if done < total:
        raise InvalidValueError(f"unfinished: {done:,} of {total:,} {unit.removesuffix('s')}s")
    tasks = [name for name in columns if name.startswith(PREFIX) and name not in NO_TASKS]
    ratios = {name.removeprefix(PREFIX): columns[name] for name in tasks}
    if not tasks:
        if np.isnan(columns["validation_optimum"]).any():
            raise InvalidValueError("the optimum is not known")
        ratios = {task: columns["validation"] / columns["validation_optimum"]}
    return [Curve(algorithm, name, seed, settings, columns, ratio) for name, ratio in ratios.items()]


def group_curves(curves: Iterable[Curve]) -> list[Group]:
    """Group curves by task and settings. Labels name the settings that differ between groups of one task."""
    groups: dict[tuple[str, str], dict[str, dict[int, Curve]]] = {}
    for curve in curves:
        settings = {name: value for name, value in curve.settings.items() if name not in SAME_RUN}
        variants = groups.setdefault((curve.task, curve.algorithm), {})
        variants.setdefault(json.dumps(settings, sort_keys=True, default=str), {})[curve.seed] = curve
    found: list[Group] = []
    for (task, algorithm), variants in groups.items():
        settings = list(map(json.loads, variants))
        names = dict.fromkeys(name for each in settings for name in each)
        differing = [name for name in names if any(each.get(name) != settings[0].get(name) for each in settings)]
        for seeds, each in zip(variants.values(), settings, strict=True):
            label = ", ".join([algorithm, *(f"{name}={each[name]}" for name in differing if name in each)])
            found.append(Group(label, task, list(seeds.values())))
    order = [*(task.short_name for task in TASKS.values()), *(group.task for group in found)]
    return sorted(found, key=lambda group: order.index(group.task))
