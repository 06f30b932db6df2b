"""Map generation: a map is a pure function of (task, version, seed)."""

import sys
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import DELIVERY_CELL, DRONE_CELL, ROAD_CELL
from drone_env.core.seeds import SPLITS, check_seed, map_key, next_key, two_halves, uniform_below
from drone_env.core.tables import (
    CELL,
    INDEX_BITS,
    NOWHERE,
    PARCELS,
    UNDER,
    Buffer,
    Tables,
    interpreted,
    state_size,
    view,
)
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError

VALIDATION, TEST = SPLITS["validation"].start, SPLITS["test"].start


def draw_road(tables: Tables, grid: Buffer, key: int) -> tuple[int, int]:
    """A cell that is still road, drawn uniformly, and the generator's state after the draw."""
    cell = uniform_below(key, tables.cells) & INDEX_BITS
    while grid[cell] != ROAD_CELL:
        key = next_key(key)
        cell = uniform_below(key, tables.cells) & INDEX_BITS
    return cell, next_key(key)


def place_anywhere(tables: Tables, grid: Buffer, state: Buffer, key: int) -> None:
    """Place the deliveries, then the terrain, each on a cell drawn again until it is still road."""
    for cell in range(tables.cells):
        grid[cell] = ROAD_CELL
    grid[state[CELL]] = DRONE_CELL
    for i in range(tables.deliveries):
        cell, key = draw_road(tables, grid, key)
        grid[cell] = DELIVERY_CELL
        state[PARCELS + i] = cell
    for kind in tables.drawn_kinds:
        cell, key = draw_road(tables, grid, key)
        grid[cell] = kind


def shuffle_in(grid: Buffer, cells: Buffer, covered: int, kinds: Buffer, key: int) -> int:
    """Add a thing of each of these kinds to the ones in random order on the first `covered` cells of a list.

    One draw each, after which all lie in random order again: the new one takes a random cell of those up to the next of
    the list, and what stood there moves to that next one (the inside-out form of Durstenfeld's shuffle, Algorithm 235,
    CACM 1964). Returns the generator's state.
    """
    later = 0
    for i in range(len(kinds)):
        if i % 2 == 0:
            bits, later = two_halves(key)
            key = next_key(key)
        else:
            bits = later
        end = (covered + i) & INDEX_BITS
        cell = cells[bits * (end + 1) >> 32]
        grid[cells[end]] = grid[cell]
        grid[cell] = kinds[i]
    return key


def place_along_streets(tables: Tables, grid: Buffer, state: Buffer, key: int) -> None:
    """Place terrain and deliveries in a city whose streets cross at the start, with one draw for each of the fewer."""
    start, spacing = state[CELL], tables.street_spacing
    city = (tables.rows[start] % spacing * spacing + tables.columns[start] % spacing) * tables.cells
    city_grid = tables.city_grids[city : city + tables.cells]
    for cell in range(tables.cells):
        grid[cell] = city_grid[cell]
    between = tables.city_cells[city : city + tables.blocks]
    along = tables.city_cells[city + tables.blocks + 1 : city + tables.cells]
    kinds = tables.drawn_kinds[: tables.drawn_between]
    key = shuffle_in(grid, between, len(between) - len(kinds), kinds, key)
    kinds = tables.drawn_kinds[tables.drawn_between :]
    covered = len(along) - tables.deliveries
    key = shuffle_in(grid, along, covered - len(kinds), kinds, key)
    for i in range(tables.deliveries):
        end = (covered + i) & INDEX_BITS
        cell = along[uniform_below(key, end + 1) & INDEX_BITS]
        key = next_key(key)
        move_parcel(tables, state, cell, along[end])
        grid[along[end]] = grid[cell]
        grid[cell] = DELIVERY_CELL
        state[PARCELS + i] = cell
    # The start may be occupied now: its content belongs on the street cell that was left out of the list.
    left_out = tables.city_cells[city + tables.blocks]
    move_parcel(tables, state, start, left_out)
    grid[left_out] = grid[start]
    grid[start] = DRONE_CELL


def move_parcel(tables: Tables, state: Buffer, cell: int, to: int) -> None:
    """Record that the parcel of a cell, if there is one, is on another cell now."""
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] == cell:
            state[i] = to


def draw_window(tables: Tables, seed: int, key: int) -> tuple[int, int]:
    """A window of the terrain, of those of the seed's split, and the generator's state after the draw."""
    split = 0
    if seed >= VALIDATION:
        split = 1
    if seed >= TEST:
        split = 2
    first, end = tables.windows[2 * split], tables.windows[2 * split + 1]
    if end - first == 1:
        return first, key
    return first + uniform_below(key, end - first), next_key(key)


def draw_open(open_cells: Buffer, grid: Buffer, key: int) -> tuple[int, int]:
    """A cell of fixed terrain that is still road and can be reached, and the generator's state after the draw."""
    cell = open_cells[uniform_below(key, len(open_cells)) & INDEX_BITS]
    while grid[cell] != ROAD_CELL:
        key = next_key(key)
        cell = open_cells[uniform_below(key, len(open_cells)) & INDEX_BITS]
    return cell, next_key(key)


def place_on_terrain(tables: Tables, grid: Buffer, state: Buffer, seed: int, key: int) -> None:
    """Place start, deliveries and pads on fixed terrain: what is fixed too, then the rest, with a draw for each."""
    window, key = draw_window(tables, seed, key)
    city_grid = tables.city_grids[window * tables.cells : (window + 1) * tables.cells]
    open_cells = tables.city_cells[tables.window_cells[window] : tables.window_cells[window + 1]]
    for cell in range(tables.cells):
        grid[cell] = city_grid[cell]
    for i in range(tables.deliveries):
        if tables.fixed[1 + i] != NOWHERE:
            state[PARCELS + i] = tables.fixed[1 + i]
            grid[state[PARCELS + i]] = DELIVERY_CELL
    state[CELL] = tables.fixed[0]
    if tables.fixed[0] == NOWHERE:
        start, key = draw_open(open_cells, grid, key)
        state[CELL] = start
    grid[state[CELL]] = DRONE_CELL
    for i in range(tables.deliveries):
        if tables.fixed[1 + i] == NOWHERE:
            cell, key = draw_open(open_cells, grid, key)
            state[PARCELS + i] = cell
            grid[cell] = DELIVERY_CELL
    for kind in tables.drawn_kinds[tables.window_pads[window] :]:
        cell, key = draw_open(open_cells, grid, key)
        grid[cell] = kind


def scatter(tables: Tables, grid: Buffer, state: Buffer, seed: int) -> None:
    """Write map `seed` into `grid` and `state`: start, deliveries and each kind of terrain, all on distinct cells."""
    key = next_key(map_key(tables.key, seed))
    state[CELL] = uniform_below(key, tables.cells)
    state[UNDER] = ROAD_CELL
    if len(tables.fixed) > 0:
        place_on_terrain(tables, grid, state, seed, next_key(key))
    elif tables.street_spacing == 0:
        place_anywhere(tables, grid, state, next_key(key))
    else:
        place_along_streets(tables, grid, state, next_key(key))


@dataclass(frozen=True, eq=False)
class CityMap:
    """A map before the flight.

    Attributes:
        task: The task that it belongs to.
        seed: `reset(seed=seed)` flies this map.
        grid: uint8[height, width], cell ids without the drone; `grid[y, x]`.
        start: (x, y) of the drone's start.
        deliveries: (x, y) of each delivery, by its index.
    """

    task: TaskConfig
    seed: int
    grid: npt.NDArray[np.uint8]
    start: tuple[int, int]
    deliveries: tuple[tuple[int, int], ...]


def generate_city_map(config: str | TaskConfig, rng: Any) -> CityMap:
    """The map of a task for a seed, or for the next draw of a random generator.

    Args:
        config: A task or its name.
        rng: A seed in [0, 2^53), or a `numpy.random.Generator` or `torch.Generator` from which one train seed is
            drawn: equal generator state, equal map.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if `rng` is none of these.
    """
    task = get_task(config)
    seed = _seed_from(rng)
    tables = interpreted(task)
    grid = np.zeros(tables.cells, np.uint8)
    state = np.zeros(state_size(tables), np.uint16)
    scatter(tables, view(grid), view(state), seed)
    grid[state[CELL]] = ROAD_CELL

    def position(cell: int) -> tuple[int, int]:
        return tables.columns[cell], tables.rows[cell]

    return CityMap(
        task=task,
        seed=seed,
        grid=np.reshape(grid, (task.height, task.width)),
        start=position(state[CELL]),
        deliveries=tuple(position(cell) for cell in state[PARCELS:]),
    )


def _seed_from(rng: Any) -> int:
    stop = SPLITS["train"].stop
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(stop))
    torch = sys.modules.get("torch")  # whoever hands in a torch.Generator has imported torch
    if torch is not None and isinstance(rng, torch.Generator):
        return int(torch.randint(stop, (), generator=rng, device=rng.device, dtype=torch.int64))
    if isinstance(rng, SupportsIndex):
        return check_seed(rng)
    raise InvalidValueError(f"rng must be a seed, a numpy.random.Generator or a torch.Generator, got {rng!r}")
