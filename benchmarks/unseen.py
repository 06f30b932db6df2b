"""How the tour network flies tasks whose sizes it was never trained on: make bench-unseen, or this file.

Prints, for the first test maps of each task, the share of the optimum and of maps on which all was delivered.
"""

import argparse
from dataclasses import replace

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.registry import register_task
from drone_env.evaluation.episodes import episodes_key, run_episodes, summarise

AGENTS = ("greedy", "tournet", "tournet-search")
LARGE = {"width": 20, "height": 20, "buildings": 125, "trees": 37, "obstacles": 22, "pads": 7, "deliveries": 6}
CHANGES = {
    "skyline_hard, 20 x 20 cells, 6 parcels, 7 pads": {**LARGE, "battery_capacity": 30, "max_steps": 200},
    "skyline_hard, 2 pads": {"pads": 2},
    "skyline_hard, no streets": {"street_spacing": 0},
    "skyline_medium, 6 parcels": {"deliveries": 6, "max_steps": 140},
    "skyline_easy, 1 parcel, 2 pads": {"deliveries": 1, "pads": 2},
    "hard_delivery, 7 parcels": {"deliveries": 7},
}
"""What sets each apart from the task that it is named after."""


def unseen(name: str) -> TaskConfig:
    """The task, registered under a name of its own."""
    number = list(CHANGES).index(name)
    own = {"id": f"unseen_{number}", "short_name": f"unseen_{number}", "grader": f"drone_env.graders:grade_{number}"}
    return register_task(replace(get_task(name.partition(",")[0]), **own, **CHANGES[name]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=200, help="test maps of each task (200)")
    maps = parser.parse_args().maps
    print(f"| task | optimum | {' | '.join(f'{agent} | delivered all' for agent in (*AGENTS, 'optimal'))} |")
    for name in CHANGES:
        task = unseen(name)
        keys = {agent: episodes_key(task, agent, split_seeds("test", maps), "test") for agent in (*AGENTS, "optimal")}
        flown = {agent: summarise(run_episodes(key)) for agent, key in keys.items()}
        figures = (f"{of['score_ratio']:.4f} | {of['success_rate']:.1%}" for of in flown.values())
        print(f"| {name} | {flown['optimal']['mean_score']:.4f} | {' | '.join(figures)} |", flush=True)


if __name__ == "__main__":
    main()
