"""The plots of a sweep: learning curves with bands, final scores with intervals."""

from pathlib import Path
from typing import Any

import numpy as np

from drone_env.files import replacing

COLOURS = ("#1c7ed6", "#e8590c", "#2b8a3e", "#ae3ec9", "#f59f00", "#0b7285", "#c92a2a", "#5c940d", "#5f3dc4", "#868e96")
MOST_CURVES = 10


def draw_plots(figures: dict[str, Any], folder: Path) -> None:
    """Draw `curves.png` and `scores.png` into a folder, each whole or not at all.

    Raises:
        OSError: if they cannot be written.
    """
    _save(_curves(figures), folder / "curves.png")
    _save(_scores(figures), folder / "scores.png")


def _figure(height: float) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(8, height), layout="constrained")
    axes: Any = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _curves(figures: dict[str, Any]) -> Any:
    """Validation scores over episodes: each setting's mean over its seeds, from its worst to its best seed shaded.

    Only episodes at which every seed of the setting was validated; settings in the order of the report.
    """
    figure, axes = _figure(4.6 + 0.2 * min(len(figures["settings"]), MOST_CURVES))
    for colour, of in zip(COLOURS, figures["settings"][:MOST_CURVES], strict=False):
        curves = [dict(t["curve"]) for t in figures["trials"] if t["setting"] == of["setting"] and t["curve"]]
        if not curves:
            continue
        last = min(max(curve) for curve in curves)
        episodes = sorted({episode for curve in curves for episode in curve if episode <= last})
        lines = np.array([np.interp(episodes, list(curve), list(curve.values())) for curve in curves])
        stopped = of["stopped_at"] is not None
        label = _short(of, 70) + (f" (stopped at {of['stopped_at']:,})" if stopped else "")
        axes.plot(episodes, lines.mean(axis=0), "--" if stopped else "-", color=colour, label=label)
        axes.fill_between(episodes, lines.min(axis=0), lines.max(axis=0), color=colour, alpha=0.15, linewidth=0)
    if figures["validation_optimum"] is not None:
        axes.axhline(figures["validation_optimum"], color="black", linestyle=":", label="exact optimum")
    more = len(figures["settings"]) - MOST_CURVES
    title = "Mean over seeds, shaded from the worst seed to the best" + (f"; {more} more not shown" * (more > 0))
    axes.set(xlabel="episodes", ylabel="validation score", title=title, ylim=(0, 1))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(frameon=False, loc="outside lower left", fontsize=9)
    return figure


def _scores(figures: dict[str, Any]) -> Any:
    """Test scores of the settings that finished, with their intervals, and the scores of their seeds."""
    shown = [of for of in figures["settings"] if of["test"]]
    figure, axes = _figure(1.9 + 0.45 * max(len(shown), 1))
    for row, of in enumerate(shown):
        test = of["test"]
        low, high = test["score"]["ci95"] or [test["score"]["mean"]] * 2
        axes.plot([low, high], [row, row], color="#1c7ed6", linewidth=3, solid_capstyle="butt")
        axes.plot(test["score"]["mean"], row, "o", color="#1c7ed6")
        axes.plot(test["seed_scores"], [row + 0.22] * len(test["seed_scores"]), ".", color="#868e96", markersize=5)
    optimum = shown[0]["test"]["optimum"] if shown else None
    if optimum is not None:
        axes.axvline(optimum, color="black", linestyle=":", label="exact optimum")
    axes.axvline(figures["greedy"]["score"], color="#e8590c", linestyle="--", label="greedy")
    axes.set_yticks(range(len(shown)), [_short(of, 45) for of in shown])
    axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    axes.set(xlabel="mean score on the test maps, 95 % interval; grey: each seed", title="Settings that finished")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(frameon=False, loc="outside lower center", ncols=2)
    return figure


def _short(of: dict[str, Any], most: int) -> str:
    """A setting's label, cut where it would leave no room for the plot."""
    label = f"{of['setting']}: {of['label']}"
    return label if len(label) <= most else f"{label[: most - 1]}…"


def _save(figure: Any, path: Path) -> None:
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
