"""`drone-env plot`: learning curves and final scores of training runs."""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from drone_env.commands.arguments import Folders
from drone_env.errors import InvalidValueError, needs
from drone_env.files import write_text
from drone_env.results.statistics import iqm_interval
from drone_env.results.tables import Table, latex, markdown, print_table
from drone_env.results.training import Group, group_curves, read_runs

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Readable with every colour vision (Okabe and Ito)."""
STYLE: Any = {"font.size": 8, "pdf.fonttype": 42, "svg.hashsalt": "drone-env"}
"""Journals refuse fonts of PDF's Type 3; the salt makes the names in an SVG the same each time."""
HEAD = ("task", "algorithm", "seeds", "IQM", "95 % interval")


def plot(folders: Folders, x: str = "cpu_seconds", out: Path = Path("plots")) -> None:
    """Draw learning curves and final scores of training runs, with intervals over seeds as in rliable.

    Runs are found in the folders, at any depth, by `config.toml` and `history.csv`. Runs whose settings differ only in
    their seeds are one group. A value is the share of the optimum at the last validation. A line or row is the
    interquartile mean (IQM) over the seeds, with its 95 % stratified bootstrap interval. Unfinished runs are left out.

    The command writes `curves` and `scores` as PDF and SVG, and the table `scores` as .md and .tex (package booktabs).

    Example: drone-env plot runs/* --x steps

    Args:
        folders: The folders.
        x: The column of the history for the horizontal axis.
        out: Folder of the files.
    """
    curves, left_out = read_runs(folders)
    for reason in left_out:
        print(f"left out: {reason}", file=sys.stderr)
    if not curves:
        raise InvalidValueError("there is no finished training run in the folders; give those of train --results")
    groups = group_curves(curves)
    with needs("train"):
        import matplotlib
    out.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE):
        _draw(groups, out / "curves", lambda axes, group, colour, _: _draw_curve(axes, group, colour, x))
        _draw(groups, out / "scores", _draw_score)
    rows = list(_rows(groups))
    print_table(Table("", HEAD, rows), names=2, sections=True)
    write_text(out / "scores.md", markdown([HEAD, *rows]) + "\n")
    write_text(out / "scores.tex", latex([HEAD, *rows]) + "\n")
    print(f"{out}: curves and scores as .pdf and .svg, scores as .md and .tex", file=sys.stderr)


def _rows(groups: Sequence[Group]) -> Iterator[tuple[str, ...]]:
    """A row for each group; then one for each label over all tasks, if it has equally many seeds of each."""
    tasks = {group.task for group in groups}
    rows = [(group.task, group.label, [group]) for group in groups]
    for label in dict.fromkeys(group.label for group in groups):
        over = [group for group in groups if group.label == label]
        even = len({len(group.curves) for group in over}) == 1 and len(over) == len(tasks) > 1
        rows += [(f"all {len(tasks)}", label, over)] if even else []
    for task, label, over in rows:
        mean, low, high = (end.item() for end in iqm_interval([group.finals for group in over]))
        interval = "-" if math.isnan(low) else f"[{low:.4f}, {high:.4f}]"
        yield task, label, str(len(over[0].curves)), f"{mean:.4f}", interval


def _draw(groups: Sequence[Group], file: Path, draw: Callable[[Any, Group, str, int], None]) -> None:
    """Draw a figure with a panel for each task, as PDF and SVG. Equal runs give equal bytes."""
    from matplotlib.figure import Figure

    tasks, labels = (list(dict.fromkeys(getattr(group, name) for group in groups)) for name in ("task", "label"))
    wide = min(len(tasks), 3)
    rows, lines = -(-len(tasks) // wide), -(-len(labels) // wide)
    figure: Any = Figure(figsize=(2.2 * wide + 0.6, 1.7 * rows + 0.2 * lines + 0.3), layout="constrained")
    panels = {task: figure.add_subplot(rows, wide, n, title=task) for n, task in enumerate(tasks, 1)}
    handles: dict[str, Any] = {}
    for group in groups:
        place, axes = labels.index(group.label), panels[group.task]
        axes.grid(alpha=0.3)
        draw(axes, group, COLOURS[place % len(COLOURS)], place)
        handles[group.label] = axes.get_legend_handles_labels()[0][-1]
    figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=wide, frameon=False)
    for kind, undated in ((".pdf", "CreationDate"), (".svg", "Date")):
        figure.savefig(file.with_suffix(kind), metadata={undated: None})


def _draw_curve(axes: Any, group: Group, colour: str, x: str) -> None:
    values, mean, low, high = group.over(x)
    axes.plot(values, mean, color=colour, label=group.label, linewidth=1)
    axes.fill_between(values, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=x.replace("cpu_", "CPU ").replace("_", " "), ylabel="share of the optimum")


def _draw_score(axes: Any, group: Group, colour: str, place: int) -> None:
    mean, low, high = (end.item() for end in iqm_interval([group.finals]))
    axes.errorbar(mean, -place, xerr=[[mean - low], [high - mean]], fmt="o", color=colour, label=group.label, capsize=2)
    axes.set(yticks=[], xlabel="share of the optimum")
