"""Tasks whose terrain is fixed: what is then drawn, and what does not fit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_env.core.cells import Cell
from drone_env.core.grid_generator import generate_city_map
from drone_env.core.seeds import SPLITS
from drone_env.core.tables import tabulate
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.core.terrain import Terrain
from drone_env.errors import InvalidTaskError
from tools.city_data import FOLDER, city_data, terrain_text

R, B, T, X, P = (int(kind) for kind in (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD))
# The last column lies behind obstacles.
CELLS = bytes([R, R, B, X, R, R, T, R, X, R, R, R, R, X, R])
ROADS = {(0, 0), (1, 0), (0, 1), (2, 1), (0, 2), (1, 2), (2, 2)}


def task(cells: bytes = CELLS, start: Any = None, parcels: Any = (), columns: int = 5, **numbers: Any) -> TaskConfig:
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
    return replace(TASKS["easy_delivery"], **given, terrain=Terrain(cells, columns, start, parcels))


def test_the_terrain_of_every_map_is_the_given_one_and_the_seed_draws_the_rest() -> None:
    config = task(pads=1)
    starts, parcels, pads = set(), set(), set()
    for seed in range(150):
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


def test_what_is_fixed_stays() -> None:
    config = task(start=(2, 2), parcels=((0, 0), (2, 1)))
    for seed in range(5):
        drawn = generate_city_map(config, seed)
        assert (drawn.start, drawn.deliveries) == ((2, 2), ((0, 0), (2, 1)))
    # A fixed parcel behind the obstacles has start and the other parcels drawn there.
    behind = task(parcels=((4, 0), (4, 2)))
    assert {generate_city_map(behind, seed).start for seed in range(20)} == {(4, 1)}
    assert {generate_city_map(task(start=(1, 0)), seed).start for seed in range(20)} == {(1, 0)}


def test_pads_of_the_terrain_stay_and_as_many_are_drawn_as_are_wanted_beside() -> None:
    cells = CELLS[:1] + bytes([P]) + CELLS[2:]
    for seed in range(20):
        assert np.argwhere(generate_city_map(task(cells), seed).grid == P).tolist() == [[0, 1]]
        beside = generate_city_map(task(cells, pads=3), seed).grid == P
        assert beside[0, 1]
        assert beside.sum() == 3


def test_each_map_of_a_larger_terrain_is_a_window_and_those_of_two_splits_share_no_cell() -> None:
    own = {"train": (T, 0, 40), "validation": (B, 40, 52), "test": (X, 52, 64)}
    city = np.zeros((5, 64), np.uint8)
    for kind, first, end in own.values():
        city[0, first:end] = kind
    city[4, ::7] = P
    config = task(city.tobytes(), columns=64, width=4, height=4, pads=2)
    lying = Terrain(city.tobytes(), 64).corners(4, 4)
    for split, (kind, first, end) in own.items():
        assert [min(lying[split]), max(lying[split])] == [(first, 0), (end - 4, 1)]
        start, stop = SPLITS[split]
        maps = [generate_city_map(config, seed).grid for seed in (*range(start, start + 50), stop - 1)]
        assert {int(n) for n in np.unique(maps)} == {R, P, kind, int(Cell.DELIVERY)}
        assert {int((grid == P).sum()) for grid in maps} == {2}
        # Windows with and without the upper row.
        assert len({(grid[0] == kind).all() for grid in maps}) == 2


def test_the_terrain_is_part_of_what_the_task_is() -> None:
    first, second = task(), task(CELLS[:-1] + bytes([T]), trees=2)
    assert first.rules()["terrain"] != second.rules()["terrain"]
    assert task(start=(0, 0)).rules()["terrain"] != first.rules()["terrain"]
    assert tabulate(first).key != tabulate(second).key
    assert {"terrain" in other.rules() for other in TASKS.values() if other.terrain is None} == {False}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cells": CELLS[:-1] + bytes([P]), "pads": 0}, "pads must be at least the 1 of the terrain, got 0"),
        ({"parcels": ((0, 0),)}, "deliveries must be 1, the parcels of the terrain, got 2"),
        ({"start": (5, 0)}, "start and parcels must be different cells, got [(5, 0)]"),
        ({"start": (0, 0), "parcels": ((1, 0), (4, 0))}, "must be connected roads; [(4, 0)] are not"),
        ({"deliveries": 7}, "8 things do not fit on 7 roads that are connected"),
        ({"width": 2, "pads": 1}, "terrain of 5 x 3 cells must be three times as wide or high as a map"),
        ({"height": 2, "cells": CELLS * 2}, "pads must be at least 1 if each map is a window of the terrain, got 0"),
        ({"height": 2, "cells": CELLS * 2, "deliveries": 6, "pads": 1}, ", in any window of train"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidTaskError) as raised:
        _ = task(**change).windows
    assert said in str(raised.value)


def test_the_shipped_cities_are_what_the_importer_makes_of_the_extract() -> None:
    made = city_data()
    for name, text in made.items():
        assert (FOLDER / f"{name}.txt").read_text("utf-8") == text
    city = get_task("city").terrain
    assert city is not None
    assert (city.attribution, city.width, city.cell) == ("Helsinki, © OpenStreetMap contributors, ODbL-1.0", 64, 16)
    assert {"Kluuvi", "Mannerheimintie", "Aleksanterinkatu"} <= {name.text for name in city.names}
    assert terrain_text(city) == made["helsinki_16"]
