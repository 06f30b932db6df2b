"""Ablations of the tour network's training recipe.

Trains the network on all tasks with one part of the recipe taken out, each for the same number of updates from the same
seed, and prints the shares of the optimum on validation maps. A part is taken out by a changed line in a copy of the
sources, or by an option of the command. A run that is finished is not repeated.
"""

import argparse
import csv
import os
import shutil
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from drone_env.errors import InvalidValueError

ROOT = Path(__file__).resolve().parent.parent


class Ablation(NamedTuple):
    """A part of the recipe, and how it is taken out."""

    options: tuple[str, ...] = ()
    """For `drone-env train`."""
    edits: tuple[tuple[str, str, str], ...] = ()
    """File of the package, code that occurs in it once, and its replacement."""


EDGES = "e = torch.relu(self.edges2(torch.relu(self.edges1(edges))))"
ABLATIONS = {
    "the whole recipe": Ablation(),
    "no second output": Ablation(
        ("--completion-weight", "0"),
        (("rl/tour_batch.py", "return preference + 2 * logsigmoid(completion)", "return preference"),),
    ),
    "edges are not handed on, they bias attention alone": Ablation(
        edits=(("rl/tour_model.py", "# b, n, h, edge", "* 0  # b, n, h, edge"),)
    ),
    "edges do not tell what is left on arrival": Ablation(
        edits=(("rl/tour_model.py", EDGES, f"edges = edges.clone()\n        edges[..., 5:9] = 0\n        {EDGES}"),)
    ),
    "all flights begin at the start of a map": Ablation(
        edits=(("rl/lessons.py", "GOES_ON = 40, 35", "GOES_ON = 100, 35"),)
    ),
    "no expected regret": Ablation(("--regret-weight", "0")),
    "the last weights, not their average": Ablation(("--average", "0")),
}


@contextmanager
def changed(ablation: Ablation) -> Generator[Path, None, None]:
    """A folder with a copy of the package without the part."""
    with TemporaryDirectory() as folder:
        package = Path(folder) / "drone_env"
        shutil.copytree(ROOT / "drone_env", package, ignore=shutil.ignore_patterns("__pycache__"))
        for name, old, new in ablation.edits:
            text = (package / name).read_text(encoding="utf-8")
            if text.count(old) != 1:
                raise InvalidValueError(f"{old!r} must stand once in {name}: it was changed, so is the ablation to be")
            (package / name).write_text(text.replace(old, new), encoding="utf-8")
        yield Path(folder)


def run(name: str, updates: int, seed: int, out: Path) -> dict[str, str]:
    """Train without a part, or read what came of it: the last line of the history."""
    folder = out / f"{'-'.join(name.replace(',', '').split())}-{updates}-seed{seed}"
    history = folder / "results" / "tournet" / "history.csv"
    if not history.exists():
        ablation = ABLATIONS[name]
        given = ("--updates", updates, "--seed", seed, "--validation-every", updates, "--validation-maps", 1000)
        with changed(ablation) as sources:
            subprocess.run(
                [sys.executable, "-m", "drone_env.cli", "train", "--network", "tournet", "--task", "all",
                 *map(str, given), *ablation.options, "--data", folder / "data", "--results",
                 folder / "results"],
                env={**os.environ, "PYTHONPATH": str(sources)}, cwd=sources, check=True,
            )  # fmt: skip
    with history.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))[-1]


def main() -> None:
    """Train and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=1000, help="of each run (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=list(ABLATIONS), choices=ABLATIONS)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "ablations")
    arguments = parser.parse_args()
    shown = ("hard", "skyline_easy", "skyline_medium", "skyline_hard")
    print(f"| recipe | {' | '.join(shown)} | CPU s |\n|---|{'---|' * len(shown)}---|")
    for name in arguments.only:
        line = run(name, arguments.updates, arguments.seed, arguments.out.resolve())
        shares = " | ".join(f"{float(line[f'validation_{task}']):.4f}" for task in shown)
        print(f"| {name} | {shares} | {float(line['cpu_seconds']):.0f} |", flush=True)


if __name__ == "__main__":
    main()
