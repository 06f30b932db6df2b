"""The plots of a report, as SVG with text that can be read and searched."""

import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, GRID, MODEL, OTHER, GOOD, BAD = "#1f2733", "#dfe4ea", "#d9480f", "#a9b4c2", "#2b8a3e", "#c92a2a"
STYLE: Any = {"svg.fonttype": "none", "svg.hashsalt": "report", "font.size": 11, "axes.edgecolor": GRID}
LEAST_BARS = 5
GOOD_OUTCOMES = ("ok", "repaired")
MOVE_COLOURS = {"best": GOOD, "good": "#74b816", "inaccuracy": "#f59f00", "mistake": "#e8590c", "blunder": BAD}


def plots(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """(title, SVG) of each plot that there is something to show for."""
    found: list[tuple[str, Any]] = []
    if figures["maps"]:
        found.append(("Mean score, same maps", _agents))
        found.append(("Score of each map, beside its optimum", _maps))
    found.append(("How requests for actions came out", _answers))
    if figures["moves"] is not None and figures["moves"]["labels"]:
        found.append(("Moves, by what they gave away", _moves))
    return [(title, _svg(draw, figures)) for title, draw in found]


def _svg(draw: Any, figures: dict[str, Any]) -> str:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.1), layout="constrained")
        axes = figure.subplots()
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
        axes.tick_params(length=0)
        draw(axes, figures)
        text = io.StringIO()
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(text, format="svg", metadata=nothing, transparent=True)
    svg = text.getvalue()
    return svg[svg.index("<svg") :]


def _bars(axes: "Axes", values: dict[str, float], colours: list[str], form: str) -> None:
    """Horizontal bars, the first on top, each with its value behind it."""
    bars = axes.barh(list(values), list(values.values()), color=colours, height=0.62)
    axes.bar_label(bars, labels=[form.format(value) for value in values.values()], padding=5)
    # As thick where there are few.
    axes.set_ylim(max(len(values), LEAST_BARS) - 0.5, -0.5)
    axes.margins(x=0.16)
    axes.set_xticks([])


def _agents(axes: "Axes", figures: dict[str, Any]) -> None:
    values = {"this model": figures["score"], **figures["baselines"]}
    known = {name: score for name, score in values.items() if score is not None}
    _bars(axes, known, [MODEL if name == "this model" else OTHER for name in known], "{:.4f}")
    axes.set_xlim(0, 1.18)
    interval = figures["score_ci95"]
    if interval is not None and figures["score"] is not None:
        axes.plot([max(0.0, interval[0]), min(1.0, interval[1])], [0, 0], color=INK, linewidth=2)


def _answers(axes: "Axes", figures: dict[str, Any]) -> None:
    counts = {name: count for name, count in figures["turns"].items() if count}
    _bars(axes, counts, [GOOD if name in GOOD_OUTCOMES else BAD for name in counts], "{:,}")


def _maps(axes: "Axes", figures: dict[str, Any]) -> None:
    maps = sorted(figures["maps"], key=lambda of_map: (min(of_map["scores"]), of_map["optimum"] or 0))
    optima = [(i, of_map["optimum"]) for i, of_map in enumerate(maps) if of_map["optimum"] is not None]
    flights = [(i, score) for i, of_map in enumerate(maps) for score in of_map["scores"]]
    if optima:
        axes.scatter(*zip(*optima, strict=True), s=46, marker="_", color=INK, linewidth=1.5, label="optimum")
    axes.scatter(*zip(*flights, strict=True), s=16, color=MODEL, alpha=0.8, linewidth=0, label="this model")
    axes.set_ylim(-0.02, 1.04)
    axes.set_xticks([])
    axes.set_xlabel(f"{len(maps)} maps, worst first")
    axes.grid(axis="y", color=GRID)
    axes.legend(loc="lower right", frameon=False)


def _moves(axes: "Axes", figures: dict[str, Any]) -> None:
    labels = figures["moves"]["labels"]
    _bars(axes, labels, [MOVE_COLOURS.get(label, OTHER) for label in labels], "{:,}")
