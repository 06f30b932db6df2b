"""Train every task from scratch with several seeds and fly the test maps.

Each run is `drone-env train` with its defaults, in a new folder under `results/evidence/`. A run that is
finished is not repeated, and one that was interrupted goes on, so this may be stopped and started at will; the time of
a run is the sum of its parts. Training sees train and validation maps only; the table is of test maps.

`--ship` puts the networks of the first seed into `drone_env/weights`, each with its model card.

`--tournet data/tournet.safetensors` flies the tour network in that file and puts it there with its card.
"""

import argparse
import dataclasses
import json
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drone_env.agents import tournet
from drone_env.agents.pathqnet import shipped_network
from drone_env.agents.tour_network import load_tour_network
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.files import replacing
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.config import preset
from drone_env.rl.run import TrainingRun
from drone_env.rl.tour_config import TourConfig
from drone_env.rl.trainer import Trainer

ROOT = Path(__file__).resolve().parent.parent
MAPS = 1000
HEADER = (
    "| task | seed | minutes | updates | steps | score | optimum | ratio | greedy's | delivered | excess | greedy's |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def figures(task: TaskConfig, agent: str) -> dict[str, Any]:
    """How an agent flies the test maps."""
    return summarise(run_episodes(episodes_key(task, agent, split_seeds("test", MAPS), "test")))


def train(task: TaskConfig, seed: int, threads: int, folder: Path) -> dict[str, Any]:
    """Train one network, or go on, or read what came of it; then fly the test maps."""
    finished = folder / "figures.json"
    if finished.exists():
        return json.loads(finished.read_text(encoding="utf-8"))
    config = dataclasses.replace(preset("fast", task.short_name), seed=seed, num_threads=threads)
    run = TrainingRun(Trainer(config), folder, folder)
    with run.stopping_on_interrupt():
        for line in run.train():
            if line.episode % config.validation_every == 0:
                print(
                    f"{task.short_name} seed {seed}: {line.episode}/{config.episodes} episodes, {run.seconds:.0f} s, "
                    f"{line.validation:.4f} of {line.validation_optimum:.4f}",
                    file=sys.stderr,
                    flush=True,
                )
    if run.stopped:
        raise SystemExit(130)
    trainer = run.trainer
    result = {
        "task": task.id,
        "task_version": task.version,
        "seed": seed,
        "command": f"drone-env train --task {task.short_name} --seed {seed} --num-threads {threads}",
        "commit": commit(),
        "seconds": round(run.seconds, 1),
        "machine": machine(),
        "packages": {name: version(name) for name in ("torch", "numpy", "numba")},
        "episodes": trainer.episodes,
        "steps": trainer.steps,
        "updates": trainer.updates,
        "validation_score": trainer.best_score,
        "validation_optimum": trainer.validator.optimum,
        "network": str(run.network.relative_to(ROOT)),
        "test": figures(task, f"pathqnet:{run.network}"),
        "greedy": figures(task, "greedy"),
        "random": figures(task, "random"),
    }
    with replacing(finished) as temporary:
        temporary.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def commit() -> str:
    """The state of the sources that trained."""
    done = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"


def machine() -> str:
    """The task of the training."""
    described = Path("/proc/cpuinfo")
    lines = described.read_text().splitlines() if described.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores, no GPU"


def row(result: dict[str, Any]) -> str:
    """A run as a row of the table."""
    test, greedy = result["test"], result["greedy"]
    excess = {name: "-" if of["mean_excess_steps"] is None else f"{of['mean_excess_steps']:.2f}"
              for name, of in (("test", test), ("greedy", greedy))}  # fmt: skip
    return (
        f"| {result['task']} | {result['seed']} | {result['seconds'] / 60:.1f} | {result['updates']:,} "
        f"| {result['steps']:,} | {test['mean_score']:.4f} | {test['mean_optimal_score']:.4f} "
        f"| {test['score_ratio']:.4f} | {greedy['score_ratio']:.4f} | {test['success_rate']:.1%} "
        f"| {excess['test']} | {excess['greedy']} |"
    )


def card(result: dict[str, Any]) -> str:
    """The model card of a shipped network."""
    task, test = get_task(result["task"], result["task_version"]), result["test"]
    (low, high), best = test["score_ci95"], result["validation_optimum"]
    agents = {"random": result["random"], "greedy": result["greedy"], "**pathqnet**": test}
    table = "\n".join(
        f"| {name} | {of['mean_score']:.4f} | {of['score_ratio']:.4f} | {of['success_rate']:.1%} "
        f"| {of['mean_steps']:.1f} |"
        for name, of in agents.items()
    )
    return f"""# PathQNet for `{task.id}`, version {task.version}

A network that flies one task: from the map and the telemetry to the value of each action (docs/learning.md has its
layers). `drone-env evaluate --task {task.short_name} --agents greedy pathqnet` flies it; it needs no PyTorch.

## How it was made

| | |
|---|---|
| command | `{result["command"]}` |
| sources | {result["commit"]} |
| time | {result["seconds"] / 60:.1f} minutes |
| machine | {result["machine"]}; {", ".join(f"{name} {number}" for name, number in result["packages"].items())} |
| flown | {result["episodes"]:,} episodes, {result["steps"]:,} steps, on maps of the train split |
| fitted | {result["updates"]:,} updates |
| chosen | the best on validation maps: {result["validation_score"]:.4f} where {best:.4f} was possible |

## How it flies

The first {MAPS:,} test maps, which training never sees; mean optimum {test["mean_optimal_score"]:.4f}. The
network's score has the 95 % interval {low:.4f} to {high:.4f}.

| agent | score | of the optimum | delivered all | steps |
|---|---|---|---|---|
{table}

## What it is not for

It knows this task's maps and numbers. On others it takes what it sees for this one.
"""


def ship(result: dict[str, Any]) -> None:
    """Put a network and its card where the agent looks for it."""
    task = get_task(result["task"], result["task_version"])
    put(shipped_network(task), (ROOT / result["network"]).read_bytes(), card(result))


def put(shipped: Path, network: bytes, written: str) -> None:
    """Write a network and its card."""
    shipped.parent.mkdir(exist_ok=True)
    with replacing(shipped) as temporary:
        temporary.write_bytes(network)
    with replacing(shipped.with_suffix(".md")) as temporary:
        temporary.write_text(written, encoding="utf-8")


def tour_card(file: Path, sources: str) -> str:
    """The model card of a tour network, by what its file says of its training and how it flies the test maps."""
    network = load_tour_network(file)
    made, usual = network.metadata, TourConfig()
    config = made["config"]
    settings = "".join(
        f" --{name.replace('_', '-')} {config[name]}"
        for name in config
        if name not in ("task", "tasks") and config[name] != getattr(usual, name)
    )
    validation = ", ".join(f"{name} {share:.4f}" for name, share in made["validation_shares"].items())
    rows: list[str] = []
    for task in TASKS.values():
        flown = {agent: figures(task, agent) for agent in ("random", "greedy", "optimal", f"tournet:{file}")}
        random, greedy, optimal, test = flown.values()
        low, high = test["score_ci95"]
        rows.append(
            f"| {task.id} v{task.version} | {optimal['mean_score']:.4f} | {random['score_ratio']:.4f} "
            f"| {greedy['score_ratio']:.4f} | **{test['score_ratio']:.4f}** | {test['mean_score']:.4f} ({low:.4f} to "
            f"{high:.4f}) | {test['success_rate']:.1%} | {optimal['success_rate']:.1%} | {test['mean_steps']:.1f} |"
        )
        print(rows[-1], file=sys.stderr, flush=True)
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numpy", "numba"))
    table = "\n".join(rows)
    return f"""# Tournet, version 1

One network for all six tasks: from what there is to see of a flight to the parcel or pad to fly to next, and the way to
it (docs/learning.md has its layers). `drone-env evaluate --task all --agents greedy tournet` flies it; it needs no
PyTorch.

## How it was made

| | |
|---|---|
| kind | {made["kind"]}: it learns from the exact value of each option, not from rewards |
| command | `drone-env train --network tournet --task {config["task"]}{settings}` |
| sources | {sources} |
| time | {made["seconds"] / 60:.1f} minutes, {made["cpu_seconds"] / 60:.1f} of CPU time |
| machine | {machine()}; {packages} |
| learned from | {made["states"]:,} states in {made["updates"]:,} updates, on maps of the train split |
| kept | the average of the weights at the end; on validation maps, of the optimum: {validation} |
| size | {sum(array.size for array in network.parameters.values()):,} parameters, {file.stat().st_size / 1e6:.2f} MB |

## How it flies

The first {MAPS:,} test maps of each task, which training never sees. Shares are of the mean optimum of the same maps.

| task | optimum | random | greedy | tournet | score (95 % interval) | delivered all | by the optimum | steps |
|---|---|---|---|---|---|---|---|---|
{table}

## What it is not for

It decides one path at a time; the exact solver finds the best flight. It flies your own tasks too: docs/learning.md has
the scores on tasks with other numbers.
"""


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["easy", "medium", "hard"], help=f"of {', '.join(TASKS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--threads", type=int, default=2, help="that PyTorch computes with")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "evidence")
    parser.add_argument("--ship", action="store_true", help="install the first seed's networks")
    parser.add_argument("--tournet", type=Path, metavar="FILE", help="install the tour network in this file instead")
    parser.add_argument("--sources", metavar="COMMIT", default=commit(), help="which trained it, if not those of now")
    arguments = parser.parse_args()
    if arguments.tournet is not None:
        written = tour_card(arguments.tournet, arguments.sources)
        put(tournet.SHIPPED, arguments.tournet.read_bytes(), written)
        return
    rows: list[str] = []
    for task in map(get_task, arguments.tasks):
        for seed in arguments.seeds:
            result = train(task, seed, arguments.threads, arguments.out.resolve() / f"{task.id}-seed{seed}")
            rows.append(row(result))
            print(rows[-1], file=sys.stderr, flush=True)
            if arguments.ship and seed == arguments.seeds[0]:
                ship(result)
    print(HEADER, *rows, sep="\n")


if __name__ == "__main__":
    main()
