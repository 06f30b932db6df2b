"""Draw what `examples/post_train.py` measured: docs/images/post_training.png.

python benchmarks/post_training.py                              # the numbers of docs/post_training.md
python benchmarks/post_training.py post-train/results.json      # those of your own run
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

ROOT = Path(__file__).resolve().parent.parent
COLOURS = {"rank": "#4a76ab", "score": "#4d9a55", "regret": "#c4722e"}
"""Of the rewards of GRPO, in their order."""
WINDOW = 50
"""Flights per mean."""


def draw(results: dict[str, Any]) -> Figure:
    """Losses of supervised fine-tuning, scores of GRPO's own flights, and scores on the test maps.

    Args:
        results: The contents of `results.json`; rows of `evaluation` need no `scores`.
    """
    figure = Figure(figsize=(11, 3.4), dpi=80, layout="constrained")
    losses, flights, test = figure.subplots(1, 3)
    for name in ("weak", "sft"):
        if name in results:
            log, answers = results[name]["log"], results[name]["answers"]
            steps = [row["step"] * answers / log[-1]["step"] / 1000 for row in log]
            losses.plot(steps, [row["loss"] for row in log], label=name)
    losses.set(yscale="log", xlabel="thousand answers", ylabel="loss per token")
    losses.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    losses.yaxis.set_major_formatter("{x:g}")
    losses.minorticks_off()
    runs = {kind: sorted(name for name in results if name.startswith(f"grpo-{kind}-")) for kind in COLOURS}
    for kind, names in runs.items():
        for name in names:
            ended = np.convolve(results[name]["ended"], np.ones(WINDOW) / WINDOW, "valid")
            label = kind if name == names[0] else None
            flights.plot(np.arange(len(ended)) + WINDOW, ended, color=COLOURS[kind], linewidth=1, label=label)
    flights.set(xlabel="finished flights", ylabel=f"score of GRPO's flights, mean of {WINDOW}")
    table = results["evaluation"]
    names = [name for name in ("optimum", "nearest", "sft", "greedy", "weak") if name in table]
    names += [name for group in runs.values() for name in group if name in table]
    means, low, high = np.array([table[name]["score"] for name in names]).T
    colours = [COLOURS.get(name.split("-")[1] if "-" in name else "", "#777777") for name in names]
    labels = [name.removeprefix("grpo-").replace("-", ", seed ") for name in names]
    test.barh(labels, means, xerr=[means - low, high - means], color=colours)
    test.invert_yaxis()
    test.set(xlim=(0, 1), xlabel="score on the test maps, 95 %")
    test.tick_params(labelsize=8)
    for axes in (losses, flights):
        axes.legend()
    return figure


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="?", default=Path(__file__).with_suffix(".json"))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "post_training.png")
    args = parser.parse_args()
    draw(json.loads(args.results.read_text(encoding="utf-8"))).savefig(args.out)
    print(args.out)


if __name__ == "__main__":
    main()
