"""The curves of training runs as pictures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drone_env.errors import needs
from drone_env.rl.trainer import Progress

CURVES = {
    "reward": "mean reward of an episode",
    "length": "mean steps of an episode",
    "loss": "loss",
    "epsilon": "share of random actions",
    "validation": "score on validation maps",
}


def draw_curves(runs: Mapping[str, Sequence[Progress]], title: str, folder: Path) -> None:
    """Draw each curve of `CURVES` over the episodes, one line per run, into `folder/<name>.png`.

    Raises:
        MissingPackageError: if Matplotlib is missing.
        OSError: if a file cannot be written.
    """
    with needs("train"):
        from matplotlib.figure import Figure
    folder.mkdir(parents=True, exist_ok=True)
    for name, label in CURVES.items():
        figure: Any = Figure(figsize=(7, 4), layout="constrained")
        axes: Any = figure.add_subplot()
        for run, history in runs.items():
            axes.plot([line.episode for line in history], [getattr(line, name) for line in history], label=run)
        if name == "validation":
            history = next(iter(runs.values()))
            axes.axhline(history[-1].validation_optimum, color="black", linestyle="--", label="exact optimum")
            axes.set_ylim(0, 1)
        axes.set(xlabel="episodes", ylabel=label, title=title)
        axes.grid(alpha=0.3)
        axes.legend()
        figure.savefig(folder / f"{name}.png", dpi=120)
