"""Draw how learners of `benchmarks/peers.py` learn, by seconds of CPU time: docs/images/learning.png.

A line is the mean over the seeds; the band reaches from the worst to the best.
"""

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from peers import LEARNERS, ROOT, SECONDS

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise


def main() -> None:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(SECONDS))
    parser.add_argument("--peers", type=Path, default=ROOT / "results" / "peers", help="folder of the runs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "learning.png")
    arguments = parser.parse_args()
    figure: Any = Figure(figsize=(10, 4), layout="constrained")
    panels: Any = figure.subplots(1, len(arguments.tasks), sharey=True, squeeze=False)[0]
    for task, axes in zip(arguments.tasks, panels, strict=True):
        curves: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        for file in sorted(arguments.peers.glob(f"{task}-*s-seed*.json")):
            flown = json.loads(file.read_text(encoding="utf-8"))
            curves[flown["learner"]].append(flown)
        for number, learner in enumerate(LEARNERS):
            if runs := curves[learner]:
                last = min(len(flown["ratio"]) for flown in runs)
                seconds, ratios = ([flown[name][:last] for flown in runs] for name in ("seconds", "ratio"))
                at, colour = np.mean(seconds, axis=0), f"C{number}"
                axes.plot(at, np.mean(ratios, axis=0), color=colour, label=learner, linewidth=1.4)
                axes.fill_between(at, np.min(ratios, axis=0), np.max(ratios, axis=0), color=colour, alpha=0.15)
        key = episodes_key(get_task(task), "nearest", split_seeds("validation", 200), "validation")
        axes.axhline(summarise(run_episodes(key))["score_ratio"], color="grey", linestyle=":", label="nearest (a rule)")
        axes.set(title=task, xlabel="CPU seconds", ylim=(0, 1.02))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("share of the optimum, 200 validation maps")
    handles, labels = panels[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(arguments.out, dpi=120)


if __name__ == "__main__":
    main()
