"""Tasks whose terrain is fixed: what is then drawn, and what does not fit."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_env.core.batch import Batch
from drone_env.core.cells import Cell
from drone_env.core.grid_generator import generate_city_map
from drone_env.core.tables import tabulate
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.core.terrain import Terrain
from drone_env.errors import InvalidTaskError
from drone_env.planning.optimal import solve

R, B, T, X, P = (int(kind) for kind in (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD))
# The last column lies behind obstacles.
CELLS = bytes([R, R, B, X, R, R, T, R, X, R, R, R, R, X, R])
ROADS = {(0, 0), (1, 0), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2)}


def task(cells: bytes = CELLS, start: Any = None, parcels: Any = (), **numbers: Any) -> TaskConfig:
    counts = dict(zip(("buildings", "trees", "obstacles", "pads"), map(cells.count, (B, T, X, P)), strict=True))
    given = {
        "width": 5,
        "height": 3,
        **counts,
        "deliveries": 2,
        "impassable": frozenset({Cell.OBSTACLE}),
        "charge_rate": 3,
        **numbers,
    }
    return replace(TASKS["easy_delivery"], **given, terrain=Terrain(cells, start, parcels))


def test_the_terrain_of_every_map_is_the_given_one_and_the_seed_draws_the_rest() -> None:
    config = task(pads=1)
    starts, parcels, pads = set(), set(), set()
    for seed in range(300):
        drawn = generate_city_map(config, seed)
        placed = [drawn.start, *drawn.deliveries, *((x, y) for y, x in np.argwhere(drawn.grid == P).tolist())]
        assert len(placed) == len(set(placed)) == 4
        ground = drawn.grid.copy()
        for x, y in placed:
            ground[y, x] = R
        assert ground.tobytes() == CELLS
        starts.add(placed[0])
        parcels |= set(placed[1:3])
        pads.add(placed[3])
    # Each road that can be reached, and none behind the obstacles.
    assert starts == parcels == pads == ROADS


def test_each_road_is_drawn_as_often() -> None:
    batch = Batch(task(), 7000)
    batch.reset(np.arange(7000))
    _, rows, columns = np.nonzero(batch.grids == Cell.DRONE)
    counts = Counter(zip(columns.tolist(), rows.tolist(), strict=True))
    assert counts.keys() == ROADS
    chi_squared = sum((n - 1000) ** 2 / 1000 for n in counts.values())
    assert chi_squared < 22.5  # 6 degrees of freedom: above it once in a thousand


def test_what_is_fixed_stays() -> None:
    config = task(start=(2, 2), parcels=((0, 0), (2, 1)))
    for seed in range(5):
        drawn = generate_city_map(config, seed)
        assert (drawn.start, drawn.deliveries) == ((2, 2), ((0, 0), (2, 1)))
    # A fixed parcel behind the obstacles has start and the other parcels drawn there.
    behind = task(parcels=((4, 0), (4, 2)))
    assert {generate_city_map(behind, seed).start for seed in range(20)} == {(4, 1)}
    assert {generate_city_map(task(start=(1, 0)), seed).start for seed in range(20)} == {(1, 0)}


def test_pads_of_the_terrain_stay_and_no_others_are_drawn() -> None:
    cells = CELLS[:1] + bytes([P]) + CELLS[2:]
    for seed in range(20):
        assert np.argwhere(generate_city_map(task(cells), seed).grid == P).tolist() == [[0, 1]]


def test_the_best_flight_goes_round_obstacles() -> None:
    wall = bytes([R, X, R, R, R, R, X, R, X, R, R, R, R, X, R])
    flight = solve(task(wall, start=(0, 0), parcels=((2, 0), (4, 2))), 0)
    assert (flight.steps, flight.order) == (10, ((2, 0), (4, 2)))


def test_the_terrain_is_part_of_what_the_task_is() -> None:
    first, second = task(), task(CELLS[:-1] + bytes([T]), trees=2)
    assert first.rules()["terrain"] != second.rules()["terrain"]
    assert task(start=(0, 0)).rules()["terrain"] != first.rules()["terrain"]
    assert tabulate(first).key != tabulate(second).key
    assert all("terrain" not in other.rules() for other in TASKS.values())
    assert {first: 1}[task()] == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cells": CELLS[1:]}, "terrain must be 5 x 3 cells, got 14"),
        ({"cells": bytes([4]) + CELLS[1:]}, "terrain may hold ['ROAD', 'BUILDING', 'TREE', 'OBSTACLE', 'PAD']"),
        ({"trees": 0}, "must be those of the terrain: {'building': 1, 'tree': 1, 'obstacle': 3, 'pad': 0}"),
        ({"cells": CELLS[:-1] + bytes([P]), "pads": 2}, "must be those of the terrain"),
        ({"width": 6, "street_spacing": 3, "cells": CELLS + bytes(3)}, "street_spacing must be 0"),
        ({"parcels": ((0, 0),)}, "deliveries must be the 1 parcels of the terrain, got 2"),
        ({"start": (5, 0)}, "start and parcels must be different cells, got [(5, 0)]"),
        ({"start": (0, -1)}, "start and parcels must be different cells"),
        ({"parcels": ((0, 0), (0, 0))}, "start and parcels must be different cells"),
        ({"start": (0, 0), "parcels": ((1, 0), (4, 0))}, "can be reached from each other; [(4, 0)] are not"),
        ({"start": (2, 0)}, "[(2, 0)] are not"),
        ({"start": (3, 0)}, "[(3, 0)] are not"),
        ({"deliveries": 7}, "8 things do not fit on 7 roads that can be reached"),
        ({"deliveries": 4, "pads": 3}, "8 things do not fit on 7 roads"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidTaskError) as raised:
        task(**change)
    assert said in str(raised.value)
