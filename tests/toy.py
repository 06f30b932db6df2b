"""Episodes on hand-drawn maps, small enough to compute every number by hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import episode_from_fields

DRONE = "@"
KINDS = {".": Cell.ROAD, "B": Cell.BUILDING, "T": Cell.TREE, "O": Cell.OBSTACLE, "P": Cell.PAD, DRONE: Cell.ROAD}
"""What the letters stand for. A digit is the parcel of that number."""

TOY = TaskConfig(
    id="toy_delivery",
    short_name="toy",
    grader="tests.toy:grade",
    width=2,
    height=2,
    deliveries=1,
    buildings=0,
    trees=0,
    obstacles=0,
    max_steps=10,
    battery_capacity=10,
    r_delivery=0.90,
    r_battery_dead=0.31,
    r_wall=0.32,
    r_blocked=0.33,
    r_obstacle=0.34,
    r_building=0.35,
    r_tree=0.36,
    r_wait=0.37,
    r_step=0.38,
)
"""Every event pays something else, so that a reward tells which event was paid."""


PLUGIN_OF_HOPS = """
from dataclasses import replace
from drone_env import get_task, register_task
hops = replace(get_task("easy"), id="hops", short_name="hops", grader="drone_env.graders:grade_hops")
register_task(replace(hops, width=5, height=5))
"""
"""A module that registers a task."""
LOG_OF_MAP_14 = """\
[START] task=drone_env.graders:grade_easy env=drone_env_v1 model={}
[STEP] step=1 action=LEFT reward=0.15 done=false error=null
[STEP] step=2 action=UP reward=0.15 done=false error=null
[STEP] step=3 action=UP reward=0.99 done=true error=null
[END] success=true steps=3 score=0.990 rewards=0.15,0.15,0.99
"""
"""The printed lines of the best flight over map 14 of easy.

Start (6, 3), parcel (5, 1). Two steps closer at 0.10 + 0.05, then 0.95 + 0.05 clamped to 0.99; score
0.8 + 0.2 * (1 - 3/60).
"""


def toy_task(drawing: list[str], **changes: Any) -> TaskConfig:
    """`TOY` with the size and the counts of the drawing. The battery holds `max_steps` units unless told otherwise."""
    cells = "".join(drawing)
    drawn = {
        "width": len(drawing[0]),
        "height": len(drawing),
        "deliveries": sum(letter.isdigit() for letter in cells),
        "buildings": cells.count("B"),
        "trees": cells.count("T"),
        "obstacles": cells.count("O"),
        "pads": cells.count("P"),
        "battery_capacity": changes.get("max_steps", TOY.max_steps),
    }
    return replace(TOY, **(drawn | changes))


def toy_episode(drawing: list[str], profile: str = "tiered", **changes: Any) -> Episode:
    """An episode at the start of the drawn map: one string per row, `@` for the drone, digits for the parcels.

    Args:
        drawing: The map, such as `["@.B", "10."]`.
        profile: Name of the reward profile.
        changes: Fields of the task that differ from `toy_task`, such as `max_steps=5`.
    """
    task, letters = toy_task(drawing, **changes), "".join(drawing)
    ground = np.array([Cell.DELIVERY if letter.isdigit() else KINDS[letter] for letter in letters], np.uint8)
    parcels = [(letters.index(str(i)), False) for i in range(task.deliveries)]
    return episode_from_fields(
        task, ground, letters.index(DRONE), task.battery_capacity, steps=0, parcels=parcels, reward_profile=profile
    )


def fly(episode: Episode, actions: str) -> list[float]:
    """Fly actions written as letters (U, D, L, R and W for WAIT) and return their rewards."""
    return [episode.step("UDLRW".index(letter)) for letter in actions]
