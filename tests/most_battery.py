"""The optimum where more battery never hurts, worked out forwards: a planner that shares nothing with `legs`.

What it keeps is the most battery with which each place can be reached.

With `efficiency_needs_all`, the score of an unfinished flight is its parcels alone, so of two ways to a place that
take the same steps the one that leaves more battery is at least as good: whatever can be flown after the other can be
flown after it, with as much battery left or more. One number for each (steps, place) then stands for all ways there.
"""

from typing import Any

import numpy as np

from drone_env.core import compiled
from drone_env.core.actions import FLYING, N_ACTIONS, Action
from drone_env.core.compile_cache import compiled_once
from drone_env.core.drone import units_left
from drone_env.core.episode import Episode
from drone_env.core.rules import outcome_of
from drone_env.core.score import score_of
from drone_env.core.tables import Tables
from drone_env.planning.map_graph import map_graph, waiting_parcels


@compiled_once(nogil=True, **compiled.OPTIONS)
def forward_kernel(
    tables: Tables, leads_to: Any, drain: Any, done: Any, start: int, steps: int, most: Any, came_from: Any, best: Any
) -> float:
    """Find the best end and return its score.

    Args:
        tables: The task's tables.
        leads_to: int32[places, 5], see `MapGraph`.
        drain: int16[places, 5], see `MapGraph`.
        done: int64[2^n], parcels delivered in all for each delivered set.
        start: The place of the drone; `most[0, start]` holds its battery.
        steps: Steps taken before.
        most: uint16[T + 1, places], zeros; receives the most battery with which a place is reached, 0 for never.
        came_from: int32[T + 1, places], receives place * 5 + action of the way there.
        best: int64[2], receives (steps flown, place * 5 + action) of the step that leads to the best end.
    """
    highest = -1.0
    for t in range(len(most) - 1):
        soonest = steps + t + 1
        if highest >= score_of(tables, tables.deliveries, tables.capacity, soonest):
            break
        for place in range(leads_to.shape[0]):
            if most[t, place] == 0:
                continue
            for action in range(N_ACTIONS):
                to = leads_to[place, action]
                battery = units_left(tables, most[t, place], drain[place, action])
                deliveries = done[to // tables.cells]
                if outcome_of(tables, deliveries, battery, soonest) == FLYING:
                    if battery > most[t + 1, to]:
                        most[t + 1, to] = battery
                        came_from[t + 1, to] = place * N_ACTIONS + action
                    continue
                score = score_of(tables, deliveries, battery, soonest)
                if score > highest:
                    highest = score
                    best[0] = t
                    best[1] = place * N_ACTIONS + action
    return highest


def best_actions(episode: Episode) -> list[Action]:
    """The actions of a best flight from where an episode stands to its end; the episode is left as it is.

    The task has `efficiency_needs_all`: else more battery may hurt.
    """
    task = episode.task
    assert task.efficiency_needs_all
    places = task.width * task.height << len(waiting_parcels(episode))
    steps_left = task.max_steps - episode.steps
    most = np.zeros((steps_left + 1, places), np.uint16)
    came_from = np.zeros(most.shape, np.int32)
    most[0, episode.cell] = episode.battery_units
    best = np.zeros(2, np.int64)
    forward_kernel(*map_graph(episode), episode.cell, episode.steps, most, came_from, best)
    t, arrow = best.tolist()
    actions = [Action(arrow % N_ACTIONS)]
    while t > 0:
        arrow = int(came_from[t, arrow // N_ACTIONS])
        actions.append(Action(arrow % N_ACTIONS))
        t -= 1
    return actions[::-1]
