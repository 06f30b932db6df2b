"""A map is a pure function of (task, version, seed), and a fair one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_env.core.cells import Cell
from drone_env.core.grid_generator import CityMap, generate_city_map
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidValueError
from tests.which_tasks import DRAWN

EASY = TASKS["easy_delivery"]
SEEDS = [seed for split in SPLITS for seed in split_seeds(split, 10)]


def contents(city: CityMap) -> tuple[bytes, tuple[int, int], tuple[tuple[int, int], ...]]:
    return city.grid.tobytes(), city.start, city.deliveries


STREETS = {
    **{name: task for name, task in TASKS.items() if task.street_spacing},
    "no_cell_free": replace(
        EASY, width=6, height=4, street_spacing=2, deliveries=5, buildings=4, trees=2, obstacles=8, pads=4
    ),
    "single_crossing": replace(EASY, width=5, height=5, street_spacing=5, deliveries=1, buildings=9, trees=7),
}


class TestContents:
    @pytest.mark.parametrize("task", {**DRAWN, **STREETS}.values(), ids={**DRAWN, **STREETS})
    def test_right_number_of_every_kind_and_deliveries_where_the_grid_shows_them(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            counts = np.bincount(city.grid.ravel(), minlength=len(Cell)).tolist()
            placed = [task.buildings, task.trees, task.obstacles, task.deliveries]
            road = task.width * task.height - sum(placed) - task.pads
            assert counts == [road, *placed, 0, 0, 0, task.pads]
            assert city.grid[city.start[::-1]] == Cell.ROAD
            assert len(set(city.deliveries)) == task.deliveries
            assert {int(city.grid[y, x]) for x, y in city.deliveries} == {Cell.DELIVERY}


class TestStreets:
    @pytest.mark.parametrize("task", STREETS.values(), ids=STREETS)
    def test_buildings_and_trees_stand_between_the_streets_and_everything_else_on_them(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            (x0, y0), (y, x) = city.start, np.indices(city.grid.shape)
            on_street = ((x - x0) % task.street_spacing == 0) | ((y - y0) % task.street_spacing == 0)
            blocks = np.isin(city.grid, (Cell.BUILDING, Cell.TREE))
            assert not (blocks & on_street).any()
            assert (blocks | on_street | (city.grid == Cell.ROAD)).all()


class TestSeed:
    @pytest.mark.parametrize("changes", [{"version": 2}, {"id": "another_delivery"}])
    def test_another_version_or_task_has_other_maps(self, changes: dict[str, Any]) -> None:
        other = replace(EASY, **changes)
        assert not any(
            contents(generate_city_map(EASY, seed)) == contents(generate_city_map(other, seed)) for seed in SEEDS
        )


class TestGenerators:
    def test_equal_state_gives_equal_maps_of_train_seeds(self) -> None:
        one, two = (np.random.default_rng(5) for _ in range(2))
        cities = [generate_city_map("easy", one) for _ in range(100)]
        for city in cities:
            again, alone = generate_city_map("easy", two), generate_city_map("easy", city.seed)
            assert contents(city) == contents(again) == contents(alone)
        seeds = {city.seed for city in cities}
        assert len(seeds) == 100
        assert 0 <= min(seeds) < 2**51 < max(seeds) < 2**52

    @pytest.mark.parametrize("junk", [None, "7", 1.5, True, -1, 2**53, np.random.RandomState(0)])
    def test_anything_else_is_refused(self, junk: Any) -> None:
        with pytest.raises(InvalidValueError, match=r"seed|numpy\.random\.Generator"):
            generate_city_map("easy", junk)
