"""Fly tasks that are no training task of the tour network.

Prints the optimum, and for each agent the optimality ratio and the share of maps on which everything is delivered.
"""

import argparse
from dataclasses import replace

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.registry import register_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise

LARGE = {"width": 20, "height": 20, "buildings": 125, "trees": 37, "obstacles": 22, "pads": 7, "deliveries": 6}
CHANGES = {
    "skyline_hard, 20 x 20 cells, 6 parcels, 7 pads": {**LARGE, "battery_capacity": 30, "max_steps": 200},
    "skyline_hard, 2 pads": {"pads": 2},
    "skyline_hard, no streets": {"street_spacing": 0},
    "skyline_medium, 6 parcels": {"deliveries": 6, "max_steps": 140},
    "skyline_easy, 1 parcel, 2 pads": {"deliveries": 1, "pads": 2},
    "hard_delivery, 7 parcels": {"deliveries": 7},
    "skyline_hard, 60 steps": {"max_steps": 60},
    "skyline_hard, 1 pad": {"pads": 1},
    "skyline_hard, battery 18": {"battery_capacity": 18},
    "skyline_hard, charge rate 1": {"charge_rate": 1},
    "city_small": {},
    "city": {},
    "city, 1,280 steps": {"max_steps": 1280},
}
"""How each task differs from the one that it is named after."""
CITY_MAPS = 100
"""Maps of a city, at most: a flight there takes a hundred times as long as elsewhere."""


def unseen(name: str) -> TaskConfig:
    """Return the task; a changed one is registered under a new name."""
    number = list(CHANGES).index(name)
    if not CHANGES[name]:
        return get_task(name)
    own = {"id": f"unseen_{number}", "short_name": f"unseen_{number}", "grader": f"drone_env.graders:grade_{number}"}
    return register_task(replace(get_task(name.partition(",")[0]), **own, **CHANGES[name]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=200, help="test maps of each task (200; of city 100 at most)")
    parser.add_argument("--network", metavar="FILE", help="an exported tour network; without one, the shipped network")
    arguments = parser.parse_args()
    file = f":{arguments.network}" if arguments.network else ""
    agents = "greedy", "nearest", "beam", f"tournet{file}", "optimal"
    print(f"| task | optimum | {' | '.join(f'{agent} | delivered all' for agent in agents)} |")
    for name in CHANGES:
        task = unseen(name)
        maps = min(arguments.maps, CITY_MAPS) if task.width == 64 else arguments.maps
        keys = {agent: episodes_key(task, agent, split_seeds("test", maps), "test") for agent in agents}
        flown = {agent: summarise(run_episodes(key)) for agent, key in keys.items()}
        figures = (f"{of['score_ratio']:.4f} | {of['success_rate']:.1%}" for of in flown.values())
        print(f"| {name} | {flown['optimal']['mean_score']:.4f} | {' | '.join(figures)} |", flush=True)


if __name__ == "__main__":
    main()
