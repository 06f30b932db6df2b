"""A map is a pure function of (task, version, seed), and a fair one."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.core.batch import Batch
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.grid_generator import CityMap, generate_city_map
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tables import CELL, PARCELS
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidTaskError, InvalidValueError, UnknownNameError

EASY = TASKS["easy_delivery"]
SEEDS = [seed for split in SPLITS for seed in split_seeds(split, 30)]


def contents(city: CityMap) -> tuple[bytes, tuple[int, int], tuple[tuple[int, int], ...]]:
    return city.grid.tobytes(), city.start, city.deliveries


def chi_square(counts: "np.ndarray[Any, Any]") -> float:
    """Squared deviations from equal counts, in units of the expected count."""
    expected = counts.sum() / counts.size
    return float(((counts - expected) ** 2).sum() / expected)


class TestContents:
    @pytest.mark.parametrize(
        "task", [task for task in TASKS.values() if task.terrain is None], ids=lambda task: task.id
    )
    def test_right_number_of_every_kind_on_distinct_cells(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            counts = np.bincount(city.grid.ravel(), minlength=len(Cell)).tolist()
            placed = [task.buildings, task.trees, task.obstacles, task.deliveries]
            road = task.width * task.height - sum(placed) - task.pads
            assert counts == [road, *placed, 0, 0, 0, task.pads]

    @pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
    def test_start_is_road_and_deliveries_are_where_the_grid_shows_them(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            x, y = city.start
            assert city.grid[y, x] == Cell.ROAD
            drawn = {(int(x), int(y)) for y, x in np.argwhere(city.grid == Cell.DELIVERY)}
            assert set(city.deliveries) == drawn
            assert len(city.deliveries) == task.deliveries

    def test_other_than_square_and_with_pads(self) -> None:
        task = replace(EASY, width=7, height=3, pads=2, buildings=1, trees=0, obstacles=0, deliveries=3)
        city = generate_city_map(task, 1)
        assert city.grid.shape == (3, 7)
        assert np.bincount(city.grid.ravel()).tolist() == [15, 1, 0, 0, 3, 0, 0, 0, 2]

    @pytest.mark.parametrize(
        "task",
        [
            replace(EASY, width=2, height=2, deliveries=3, buildings=0, trees=0, obstacles=0),
            replace(EASY, buildings=91),
            replace(EASY, width=64, height=64, deliveries=16, buildings=4000, trees=40, obstacles=30, pads=9),
        ],
        ids=["2x2", "10x10", "64x64"],
    )
    def test_a_map_without_a_free_cell_is_finished(self, task: TaskConfig) -> None:
        city = generate_city_map(task, 0)
        assert np.argwhere(city.grid == Cell.ROAD).tolist() == [[city.start[1], city.start[0]]]


STREETS = {
    **{name: task for name, task in TASKS.items() if task.street_spacing},
    "no_cell_free": replace(
        EASY, width=6, height=4, street_spacing=2, deliveries=5, buildings=4, trees=2, obstacles=8, pads=4
    ),
    "oblong": replace(
        EASY, width=3, height=12, street_spacing=3, deliveries=2, buildings=7, trees=5, obstacles=1, pads=3
    ),
    "single_crossing": replace(EASY, width=5, height=5, street_spacing=5, deliveries=1, buildings=9, trees=7),
}


class TestStreets:
    @pytest.mark.parametrize("task", STREETS.values(), ids=STREETS)
    def test_buildings_and_trees_stand_between_the_streets_and_everything_else_on_them(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            x0, y0 = city.start
            for y, x in np.ndindex(city.grid.shape):
                on_street = (x - x0) % task.street_spacing == 0 or (y - y0) % task.street_spacing == 0
                if city.grid[y, x] in (Cell.BUILDING, Cell.TREE):
                    assert not on_street
                elif city.grid[y, x] != Cell.ROAD:
                    assert on_street

    @pytest.mark.parametrize("task", STREETS.values(), ids=STREETS)
    def test_counts_are_exact(self, task: TaskConfig) -> None:
        for seed in SEEDS:
            city = generate_city_map(task, seed)
            counts = np.bincount(city.grid.ravel(), minlength=len(Cell))
            assert counts[Cell.DELIVERY] == len(set(city.deliveries)) == task.deliveries
            for kind, count in task.cell_counts().items():
                assert counts[kind] == count
            assert city.grid[city.start[1], city.start[0]] == Cell.ROAD

    def test_the_crossing_is_the_start_wherever_that_is(self) -> None:
        task = STREETS["single_crossing"]
        maps = [generate_city_map(task, seed) for seed in range(1000)]
        assert {city.start for city in maps} == {(x, y) for x in range(5) for y in range(5)}
        for city in maps:
            # All 16 cells between the streets are built on, so the streets are what is left.
            built = np.isin(city.grid, (Cell.BUILDING, Cell.TREE))
            assert (np.flatnonzero(~built.any(axis=0)).tolist(), np.flatnonzero(~built.any(axis=1)).tolist()) == (
                [city.start[0]],
                [city.start[1]],
            )

    def test_everything_that_may_stand_on_a_cell_does_so_on_some_map(self) -> None:
        task = STREETS["oblong"]
        seen: dict[tuple[int, int], set[int]] = {}
        for seed in range(2000):
            city = generate_city_map(task, seed)
            for y, x in np.ndindex(city.grid.shape):
                from_crossing = ((x - city.start[0]) % 3, (y - city.start[1]) % 3)
                seen.setdefault(from_crossing, set()).add(int(city.grid[y, x]))
        between = {Cell.ROAD, Cell.BUILDING, Cell.TREE}
        on_street = {Cell.ROAD, Cell.OBSTACLE, Cell.DELIVERY, Cell.PAD}
        assert seen == {(x, y): between if x and y else on_street for x in range(3) for y in range(3)}

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"street_spacing": 3}, "street_spacing must be 0, or 2 to 16 and divide width and height, got 3"),
            ({"street_spacing": -5}, "street_spacing must be 0, or 2 to 16 and divide width and height, got -5"),
            ({"street_spacing": 1}, "street_spacing must be 0, or 2 to 16 and divide width and height, got 1"),
            ({"street_spacing": 20}, "street_spacing must be 0, or 2 to 16 and divide width and height, got 20"),
            (
                {"street_spacing": 5, "width": 12},
                "street_spacing must be 0, or 2 to 16 and divide width and height, got 5",
            ),
            ({"street_spacing": 32, "width": 64, "height": 64}, "street_spacing must be 0, or 2 to 16 and divide"),
            ({"street_spacing": 2.0}, "street_spacing must be an integer"),
            ({"street_spacing": 5, "buildings": 61}, "65 buildings and trees do not fit on 64 cells between"),
            ({"street_spacing": 10, "pads": 15}, "20 things do not fit on 19 cells of street"),
            ({"efficiency_needs_all": 1}, "efficiency_needs_all must be True or False"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, changes: dict[str, Any], message: str) -> None:
        with pytest.raises(InvalidTaskError, match=f"^task 'easy_delivery': .*{message}"):
            replace(EASY, **changes)

    @pytest.mark.parametrize(
        "changes",
        [
            {"street_spacing": 5, "buildings": 60},
            {"street_spacing": 10, "pads": 14},
            {"street_spacing": 2},
            {"street_spacing": 16, "width": 64, "height": 64},
        ],
    )
    def test_the_bounds_themselves_are_allowed(self, changes: dict[str, Any]) -> None:
        generate_city_map(replace(EASY, **changes), 0)


class TestSeed:
    @pytest.mark.parametrize("task", TASKS)
    def test_equal_seed_gives_an_equal_map(self, task: str) -> None:
        for seed in SEEDS[::5]:
            assert contents(generate_city_map(task, seed)) == contents(generate_city_map(task, seed))

    @pytest.mark.parametrize("task", TASKS)
    def test_different_seeds_give_different_maps(self, task: str) -> None:
        assert len({contents(generate_city_map(task, seed)) for seed in SEEDS}) == len(SEEDS)

    @pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
    def test_reset_flies_the_map_of_the_seed(self, task: TaskConfig) -> None:
        episode = Episode(task)
        for seed in [*SEEDS[::5], 2**53 - 1]:
            episode.reset(seed)
            city = generate_city_map(task, seed)
            x, y = city.start
            seen = city.grid.copy()
            seen[y, x] = Cell.DRONE
            assert city.seed == seed
            assert episode.position == city.start
            assert episode.parcels == [(*position, False) for position in city.deliveries]
            assert np.array_equal(episode.grid(), seen)

    @pytest.mark.parametrize("changes", [{"version": 2}, {"id": "another_delivery"}])
    def test_another_version_or_task_has_other_maps(self, changes: dict[str, Any]) -> None:
        other = replace(EASY, **changes)
        same = sum(
            contents(generate_city_map(EASY, seed)) == contents(generate_city_map(other, seed)) for seed in SEEDS
        )
        assert same == 0

    def test_maps_do_not_depend_on_rewards(self) -> None:
        other = replace(EASY, r_step=0.5, max_steps=99)
        assert contents(generate_city_map(EASY, 3)) == contents(generate_city_map(other, 3))


class TestGenerators:
    def test_equal_numpy_generator_state_gives_an_equal_map(self) -> None:
        one, two = np.random.default_rng(5), np.random.default_rng(5)
        for _ in range(5):
            assert contents(generate_city_map("hard", one)) == contents(generate_city_map("hard", two))

    def test_numpy_generator_draws_different_train_seeds(self) -> None:
        rng = np.random.default_rng(5)
        seeds = [generate_city_map("easy", rng).seed for _ in range(300)]
        assert len(set(seeds)) == 300
        assert all(0 <= seed < 2**52 for seed in seeds)
        assert max(seeds) > 2**51

    def test_torch_generator(self) -> None:
        import torch  # takes a second, which no other test here should wait for

        one, two = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
        seeds = []
        for _ in range(300):
            city = generate_city_map("hard", one)
            assert contents(city) == contents(generate_city_map("hard", two))
            seeds.append(city.seed)
        assert len(set(seeds)) == 300
        assert all(0 <= seed < 2**52 for seed in seeds)
        assert max(seeds) > 2**51

    def test_the_drawn_seed_gives_the_map_again(self) -> None:
        city = generate_city_map("medium", np.random.default_rng(6))
        assert contents(generate_city_map("medium", city.seed)) == contents(city)

    @pytest.mark.parametrize("seed", [3, np.int64(3), np.uint8(3)])
    def test_any_integer_type_is_a_seed(self, seed: Any) -> None:
        assert contents(generate_city_map("easy", seed)) == contents(generate_city_map("easy", 3))

    @pytest.mark.parametrize(
        "junk", [None, "7", 1.5, True, -1, 2**53, [1], np.random.RandomState(0), np.float64(1), object()]
    )
    def test_anything_else_is_refused(self, junk: Any) -> None:
        with pytest.raises(InvalidValueError, match=r"seed|numpy\.random\.Generator"):
            generate_city_map("easy", junk)

    def test_unknown_task_is_refused(self) -> None:
        with pytest.raises(UnknownNameError, match="easy, hard"):
            generate_city_map("expert", 1)


def drawn(
    task: TaskConfig, seeds: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Terrain, start and parcels of many maps, as the batch draws them; that one alone is equal, other tests show."""
    batch = Batch(task, len(seeds))
    batch.reset(seeds)
    grids, states = (batch.get_state()[name] for name in ("grids", "states"))
    return grids, states[:, CELL].astype(int), states[:, PARCELS:].astype(int)


class TestFairness:
    """The bounds lie some six standard deviations from the mean of a fair generator; the seeds are fixed."""

    def test_start_and_delivery_are_uniform(self) -> None:
        _, starts, parcels = drawn(EASY, np.arange(20_000))
        # 99 degrees of freedom: mean 99, standard deviation 14
        assert 30 < chi_square(np.bincount(starts, minlength=100)) < 185
        assert 30 < chi_square(np.bincount(parcels[:, 0], minlength=100)) < 185

    def test_terrain_is_uniform(self) -> None:
        grids, _, _ = drawn(EASY, np.array(split_seeds("test", 5_000)))
        for kind in (Cell.BUILDING, Cell.TREE, Cell.OBSTACLE):
            assert 30 < chi_square(np.sum(grids == kind, axis=0)) < 185

    def test_start_and_delivery_of_one_map_are_independent(self) -> None:
        task = replace(EASY, width=3, height=3, buildings=0, trees=0, obstacles=0)
        _, starts, parcels = drawn(task, np.arange(10_000))
        pairs = np.bincount(starts * 9 + parcels[:, 0], minlength=81).reshape(9, 9)
        # 72 pairs of distinct cells, 71 degrees of freedom: mean 71, standard deviation 12
        assert 15 < chi_square(pairs[~np.eye(9, dtype=bool)]) < 145
        assert pairs.trace() == 0

    def test_what_stands_in_a_city_is_uniform_over_the_cells_where_it_may(self) -> None:
        grids, starts, parcels = drawn(TASKS["skyline_easy"], np.arange(100_000))
        # 63 degrees of freedom: mean 63, standard deviation 11
        assert 15 < chi_square(np.bincount(starts, minlength=64)) < 130
        cells = np.arange(64)
        for way in range(16):
            of_way = (starts // 8 % 4 == way // 4) & (starts % 4 == way % 4)
            on_street = (cells // 8 % 4 == way // 4) | (cells % 4 == way % 4)
            for kind in (Cell.BUILDING, Cell.TREE):
                # 36 cells: mean 35, standard deviation 8 at most, as the cells of one map are distinct
                counts = np.sum(grids[of_way][:, ~on_street] == kind, axis=0)
                assert 1 < chi_square(counts) < 90
            crossings = on_street & (cells // 8 % 4 == way // 4) & (cells % 4 == way % 4)
            for kind in (Cell.OBSTACLE, Cell.PAD, Cell.DELIVERY):
                # 28 cells, of which four are the start on a quarter of the maps
                counts = np.sum(grids[of_way][:, on_street] == kind, axis=0) / np.where(crossings[on_street], 0.75, 1)
                assert 1 < chi_square(counts) < 75
        # From the start, each two places on the streets are as likely for the first two parcels as any other two:
        # 27 * 26 pairs, mean 701, standard deviation 37.
        places = (parcels // 8 - (starts // 8)[:, None]) % 8 * 8 + (parcels % 8 - (starts % 8)[:, None]) % 8
        pairs = np.bincount(places[:, 0] * 64 + places[:, 1], minlength=4096)
        assert np.count_nonzero(pairs) == 27 * 26
        assert 480 < chi_square(pairs[pairs > 0]) < 925

    def test_maps_of_neighbouring_seeds_are_independent(self) -> None:
        task = replace(EASY, width=3, height=3, buildings=0, trees=0, obstacles=0)
        _, starts, _ = drawn(task, np.arange(10_001))
        pairs = np.zeros((9, 9))
        np.add.at(pairs, (starts[:-1], starts[1:]), 1)
        # 80 degrees of freedom: mean 80, standard deviation 13
        assert 20 < chi_square(pairs) < 160
