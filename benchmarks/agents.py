"""How many decisions agents make in a second of one core's computing, and how well: make bench-agents, or this file.

Each flies the first test maps of each task, all together, and is timed while it is asked for actions: what it computes
of the observations is in the figures, the simulator is not. One thread computes. Compiling is done before, on other
maps.
"""

import argparse
import os
import time

os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

import numpy as np
import numpy.typing as npt

from drone_env.agents import BatchAgent, make_agent
from drone_env.agents.together import fly_together
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import UnsupportedTaskError

AGENTS = ("greedy", "pathqnet", "tournet", "tournet-search", "tournet-search-64", "optimal")


def measure(task_name: str, agent_name: str, seeds: npt.NDArray[np.int64]) -> tuple[float, int, float]:
    """The mean score, the decisions made, and the CPU seconds that they took."""
    task = get_task(task_name)
    agent = make_agent(agent_name, task)
    assert isinstance(agent, BatchAgent)
    decisions, seconds = 0, 0.0

    def act(grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        nonlocal seconds
        begun = time.process_time()
        actions = agent.act_batch(grids, telemetry)
        seconds += time.process_time() - begun
        return actions

    agent.reset_batch(seeds)
    ends = fly_together(task, seeds, act, getattr(agent, "stateless", False))
    decisions = int(ends.steps.sum())
    return float(ends.scores.mean()), decisions, seconds


def main() -> None:
    """Print a row for each task and agent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS))
    parser.add_argument("--agents", nargs="+", default=list(AGENTS))
    parser.add_argument("--network", help="file of a tour network instead of the shipped one")
    parser.add_argument("--maps", type=int, default=100)
    args = parser.parse_args()
    seeds, warm = np.array(split_seeds("test", args.maps)), np.array(split_seeds("validation", 2))
    print("| task | agent | share of the optimum | decisions per CPU-s | maps per CPU-s |\n|---|---|---|---|---|")
    for task in args.tasks:
        measure(task, "optimal", warm)
        optimum, *_ = measure(task, "optimal", seeds)
        for agent in args.agents:
            by_file = args.network is not None and agent.startswith("tournet")
            name = f"{agent}:{args.network}" if by_file else agent
            try:
                measure(task, name, warm)
            except UnsupportedTaskError:
                continue
            score, decisions, seconds = measure(task, name, seeds)
            rates = f"{decisions / seconds:,.0f} | {len(seeds) / seconds:,.1f}"
            print(f"| {task} | {agent} | {score / optimum:.4f} | {rates} |", flush=True)


if __name__ == "__main__":
    main()
