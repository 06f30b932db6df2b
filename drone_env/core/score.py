"""The graded score: the one formula behind graders, observations, rewards and solvers."""

from drone_env.core.tables import BATTERY, DELIVERIES_DONE, STEPS, Buffer, Tables

LOWEST = 0.01
HIGHEST = 0.99


def score_of(tables: Tables, deliveries_done: int, battery: int, steps: int) -> float:
    """0.8 * done/total + 0.2 * (0.5 * battery/capacity + 0.5 * (1 - steps/max_steps)), in [0.01, 0.99].

    With `efficiency_needs_all` the second part counts only when everything is delivered. Computed as one correctly
    rounded division of integers, so equal flights have equal scores to the last bit.
    """
    total, capacity, max_steps = tables.deliveries, tables.capacity, tables.max_steps
    needs_all = tables.efficiency_needs_all  # read here: inside the condition it costs a compiled step 4 %
    tenths = 8 * deliveries_done * capacity * max_steps
    if deliveries_done == total or not needs_all:
        tenths += total * (battery * max_steps + (max_steps - steps) * capacity)
    return min(max(tenths / (10 * total * capacity * max_steps), LOWEST), HIGHEST)


def score(tables: Tables, state: Buffer) -> float:
    """The score of the episode as it stands: provisional until it has ended."""
    return score_of(tables, state[DELIVERIES_DONE], state[BATTERY], state[STEPS])


EFFICIENCY_WEIGHTS = {"parcels delivered": 75, "battery left": 15, "steps left": 10}
"""What the efficiency is made of, in percent: a figure for people to look at, paid nowhere."""
