"""The graded score: the one formula behind graders, observations, rewards and solvers."""

from drone_env.core.tables import BATTERY, DELIVERIES, STEPS, Buffer, Tables

LOWEST = 0.01
HIGHEST = 0.99


def score_of(
    deliveries: int, total: int, battery: int, capacity: int, steps: int, max_steps: int, efficiency_needs_all: int = 0
) -> float:
    """0.8 * deliveries/total + 0.2 * (0.5 * battery/capacity + 0.5 * (1 - steps/max_steps)), in [0.01, 0.99].

    With `efficiency_needs_all` the second part counts only when everything is delivered. Computed as one correctly
    rounded division of integers, so equal missions have equal scores to the last bit.
    """
    tenths = 8 * deliveries * capacity * max_steps
    if deliveries == total or not efficiency_needs_all:
        tenths += total * (battery * max_steps + (max_steps - steps) * capacity)
    return min(max(tenths / (10 * total * capacity * max_steps), LOWEST), HIGHEST)


def score(tables: Tables, state: Buffer) -> float:
    """The score of the episode as it stands: provisional until it has ended."""
    return score_of(
        state[DELIVERIES],
        tables.deliveries,
        state[BATTERY],
        tables.capacity,
        state[STEPS],
        tables.max_steps,
        tables.efficiency_needs_all,
    )


EFFICIENCY_WEIGHTS = {"parcels delivered": 75, "battery left": 15, "steps left": 10}
"""What the efficiency is made of, in percent: a figure for people to look at, paid nowhere."""


def efficiency_shares(tables: Tables, state: Buffer) -> tuple[float, float, float]:
    """The share of each part of the efficiency, 0 to 1, in the order of `EFFICIENCY_WEIGHTS`."""
    return state[DELIVERIES] / tables.deliveries, state[BATTERY] / tables.capacity, 1 - state[STEPS] / tables.max_steps


def efficiency(tables: Tables, state: Buffer) -> float:
    """The weighted sum of the shares, 0 to 100."""
    shares = efficiency_shares(tables, state)
    return sum(weight * share for weight, share in zip(EFFICIENCY_WEIGHTS.values(), shares, strict=True))
