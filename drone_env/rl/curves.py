"""The curves of training runs as pictures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from drone_env.errors import needs


def draw_curves(runs: Mapping[str, Sequence[Any]], title: str, curves: Mapping[str, str], folder: Path) -> None:
    """Draw curves over the first field of the log's lines, one line per run, into `folder/<name>.png`.

    Args:
        runs: The lines of each run's log, dataclasses, by its name.
        title: Of every curve.
        curves: The fields to draw, and what they are; one that holds several figures is a line for each.
        folder: Made if it is missing.

    Raises:
        MissingPackageError: if Matplotlib is missing.
        OSError: if a file cannot be written.
    """
    with needs("train"):
        from matplotlib.figure import Figure
    folder.mkdir(parents=True, exist_ok=True)
    counted = next(field.name for field in fields(next(iter(runs.values()))[0]))
    for name, label in curves.items():
        figure: Any = Figure(figsize=(7, 4), layout="constrained")
        axes: Any = figure.add_subplot()
        for run, history in runs.items():
            at = [getattr(line, counted) for line in history]
            drawn: list[Any] = [getattr(line, name) for line in history]
            parts: list[dict[str, float]] = drawn if isinstance(drawn[0], Mapping) else [{run: of} for of in drawn]
            for part in parts[0]:
                axes.plot(at, [figures[part] for figures in parts], label=part)
        if name in ("validation", "shares"):
            optimum = next(iter(runs.values()))[-1].validation_optimum
            if not math.isnan(optimum):
                axes.axhline(optimum, color="black", linestyle="--", label="exact optimum")
            axes.set_ylim(0, 1)
        axes.set(xlabel=f"{counted}s", ylabel=label, title=title)
        axes.grid(alpha=0.3)
        axes.legend()
        figure.savefig(folder / f"{name}.png", dpi=120)
