"""What a drone has around it: the entries of stops, and the masks of actions, state by state."""

import numpy as np
import pytest

from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.forms import StopEntries
from drone_env.planning.from_observation import read_observations
from drone_env.planning.nearby import (
    BUCKETS,
    COSTS,
    ENTRIES,
    NEIGHBOURS,
    SPARES,
    UNITS,
    action_masks,
    bucket,
    entries_of,
)
from drone_env.planning.paths import UNIT_COST, cheapest_paths, cheapest_ways

TASKS = ("medium", "skyline_easy", "skyline_hard", "rush_easy", "city_small")


def test_buckets_are_exact_up_to_fifteen() -> None:
    numbers = [-9, -1, *range(16), 16, 19, 20, 43, 44, 9999]
    assert [bucket(number) for number in numbers] == [0, 0, *range(1, 17), 17, 17, 18, 23, 24, 24]


def delivered(task: TaskConfig, cell: int, units: int, left: int, parcels: list[int]) -> int:
    """Parcels that nearest neighbour delivers; of equally near ones, the first of the sorted `parcels`."""

    def steps(parcel: int) -> int:
        return sum(abs(a - b) for a, b in zip(divmod(cell, task.width), divmod(parcel, task.width), strict=True))

    if not parcels or (nearest := min(map(steps, parcels))) > min(units, left):
        return 0
    parcel = min(parcels, key=steps)
    rest = [other for other in parcels if other != parcel]
    return 1 + delivered(task, parcel, units - nearest, left - nearest, rest)


@pytest.mark.parametrize("name", TASKS)
def test_the_entries_are_costs_first_actions_and_spare_units(name: str) -> None:
    """Each from the paths of the state, one stop at a time."""
    task, rng, n = get_task(name), np.random.default_rng(0), 4
    look, batch = StopEntries(task, deliveries=True), Batch(task, n)
    batch.reset(np.arange(n))
    for _ in range(12):
        entries = look({"grid": batch.grids, "telemetry": batch.telemetry})["entries"]
        grounds, drones = read_observations(task, batch.grids, batch.telemetry)
        for shown, ground, (cell, units, left), mask in zip(entries, grounds, drones, batch.action_masks, strict=True):
            costs, first = cheapest_ways(task, ground, cell)
            ways, _ = cheapest_paths(task, ground[None], np.array([cell]))
            pads, parcels = (np.flatnonzero(ground == kind).tolist() for kind in (Cell.PAD, Cell.DELIVERY))
            beside = enumerate(cell + np.array([-task.width, task.width, -1, 1]))
            expected = [NEIGHBOURS + a * N_CELL_KINDS + int(ground[to]) for a, to in beside if mask[a]]
            for stop in (*pads, *parcels):
                if costs[stop] < 0:
                    continue
                spare = units - costs[stop] - 1
                if stop in parcels and pads and len(parcels) > 1:
                    back = [cost for cost in cheapest_ways(task, ground, stop)[0][pads].tolist() if cost >= 0]
                    spare = spare - min(back) if back else -1
                row = ((stop in parcels) * N_ACTIONS + (4 if stop == cell else first[stop])) * BUCKETS
                after, waits = units - costs[stop], 0
                if stop in pads and after > 0:
                    after, waits = task.battery_capacity, -(-(task.battery_capacity - after) // task.charge_rate)
                done = delivered(task, stop, after, left - int(ways[0, stop] % UNIT_COST) - waits, parcels)
                expected += [COSTS + row + bucket(costs[stop]), SPARES + row + bucket(spare)]
                expected += [ENTRIES + row + bucket(done)]
            assert sorted(shown[shown > 0].tolist()) == sorted([UNITS + bucket(units), *expected])
        batch.step(np.where(batch.action_masks.astype(bool), rng.random((n, N_ACTIONS)), 0).argmax(axis=1))


@pytest.mark.parametrize("name", TASKS)
def test_masks_from_observations_are_those_of_the_rules(name: str) -> None:
    task, rng, n = get_task(name), np.random.default_rng(1), 50
    batch = Batch(task, n)
    batch.reset(np.arange(n))
    for _ in range(30):
        masks = action_masks(entries_of(task, batch.grids, batch.telemetry))
        assert (masks == batch.action_masks).all()
        batch.step(rng.integers(N_ACTIONS, size=n))


def test_one_observation_and_many_have_the_same_form() -> None:
    task = get_task("skyline_medium")
    look, batch = StopEntries(task), Batch(task, 3)
    batch.reset(np.arange(3))
    many = look({"grid": batch.grids, "telemetry": batch.telemetry})
    for i in range(3):
        one = look({"grid": batch.grids[i], "telemetry": batch.telemetry[i]})
        assert one in look.space
        assert all(np.array_equal(one[name], many[name][i]) for name in many)
