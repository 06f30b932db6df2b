"""Draw how networks learn on Skyline, by seconds of CPU time: docs/images/learning.png.

Reads `history.csv` of the tour network's trainings, and the results of `benchmarks/peers.py`.

    python benchmarks/learning_curves.py --runs distilled=results/tournet rewards=results/tournet_rewards
"""

import argparse
import csv
import json
from itertools import groupby
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise

ROOT = Path(__file__).resolve().parent.parent
TASKS = ("skyline_easy", "skyline_medium", "skyline_hard")
Curve = tuple[str, list[float], list[float]]
"""Who learned, CPU seconds, shares of the optimum on validation maps."""


def of_tour_network(kind: str, folder: Path, task: str) -> Curve:
    """One training of the tour network; one line for each validation."""
    with (folder / "history.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["validation"] != "nan"]
    # Between two validations the share is repeated.
    first = [next(same) for _, same in groupby(rows, lambda row: row["validation"])]
    share = [float(row[f"validation_{task}"]) for row in first]
    return f"tour network, {kind}", [float(row["cpu_seconds"]) for row in first], share


def of_peers(folder: Path, task: str) -> list[Curve]:
    """The trainings of `benchmarks/peers.py`."""
    runs = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob(f"{task}-*-seed*.json"))]
    return [(run["algorithm"], run["curve"]["cpu_seconds"], run["curve"]["ratio"]) for run in runs]


def main() -> None:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", nargs="+", default=[], metavar="KIND=FOLDER", help="trainings of the tour network")
    parser.add_argument("--peers", type=Path, default=ROOT / "results" / "peers")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "learning.png")
    arguments = parser.parse_args()
    runs = [(kind, Path(folder)) for kind, _, folder in (run.partition("=") for run in arguments.runs)]
    figure: Any = Figure(figsize=(10, 4), layout="constrained")
    panels: Any = figure.subplots(1, len(TASKS), sharex=True, sharey=True)
    colours: dict[str, str] = {}
    for task, axes in zip(TASKS, panels, strict=True):
        for name, seconds, share in [of_tour_network(*run, task) for run in runs] + of_peers(arguments.peers, task):
            label = None if name in colours else name
            colour = colours.setdefault(name, f"C{len(colours)}")
            axes.plot(seconds, share, color=colour, label=label, linewidth=1.4)
        key = episodes_key(get_task(task), "greedy", split_seeds("validation", 200), "validation")
        greedy = summarise(run_episodes(key))["score_ratio"]
        axes.axhline(greedy, color="grey", linestyle=":", label="nearest parcel (greedy)")
        axes.set(title=task, xlabel="CPU seconds", xscale="log", ylim=(0, 1.02))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("share of the optimum, 200 validation maps")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(arguments.out, dpi=120)


if __name__ == "__main__":
    main()
