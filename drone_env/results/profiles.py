"""Performance profiles as a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.errors import InvalidValueError, needs
from drone_env.files import replacing
from drone_env.results.reliable import profile

FORMATS = (".png", ".svg")
COLUMNS, WIDE, HIGH = 3, 4.2, 3.2
"""Of the picture, and inches of each part."""


def check_plot(file: Path) -> None:
    """See that a picture can be drawn into a file, before anything is flown.

    Raises:
        InvalidValueError: if it ends in no known format, or its folder does not exist.
        MissingPackageError: if Matplotlib is missing.
    """
    if file.suffix not in FORMATS or not file.parent.is_dir():
        raise InvalidValueError(f"--plot takes a file in a folder that exists, .svg or .png; got {file}")
    with needs("train"):
        import matplotlib.figure  # noqa: F401  # pyright: ignore[reportUnusedImport] - only whether it is there


def draw_profiles(tasks: Mapping[str, Mapping[str, npt.NDArray[np.float64]]], file: Path) -> None:
    """Draw for each task and agent the share of maps above each value, with its interval (95 %) shaded.

    Args:
        tasks: By task and agent one value a map, float64[n].
        file: Where to.

    Raises:
        OSError: if it cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    across = min(len(tasks), COLUMNS)
    down = -(-len(tasks) // across)
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "profiles"}):
        figure: Any = Figure(figsize=(WIDE * across, HIGH * down), layout="constrained")
        parts: Any = figure.subplots(down, across, squeeze=False).flat
        for axes, (task, agents) in zip(parts, tasks.items(), strict=False):
            every = np.concatenate([*agents.values()])
            thresholds = np.linspace(float(every.min()) - 0.01, 1, 201)
            for agent, values in agents.items():
                share, low, high = profile(values, thresholds)
                (line,) = axes.plot(thresholds, share, label=agent, drawstyle="steps-post")
                axes.fill_between(thresholds, low, high, alpha=0.2, linewidth=0, step="post", color=line.get_color())
            axes.set(title=task, xlabel="share of the optimum, more than", ylabel="share of maps", ylim=(-0.02, 1.02))
            axes.grid(alpha=0.3)
            axes.legend(frameon=False, loc="lower left")
        for axes in list(parts)[len(tasks) :]:
            axes.set_axis_off()
        with replacing(file) as temporary:
            nothing = {"Date": None} if file.suffix == ".svg" else {}
            figure.savefig(temporary, dpi=120, format=file.suffix[1:], metadata=nothing)
