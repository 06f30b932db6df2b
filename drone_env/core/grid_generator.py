"""Map generation: a map is a pure function of (task, version, seed)."""

import sys
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import DELIVERY_CELL, DRONE_CELL, ROAD_CELL
from drone_env.core.seeds import SPLITS, check_seed, map_key, next_key, two_halves, uniform_below
from drone_env.core.tables import CELL, INDEX_BITS, NOWHERE, PARCELS, UNDER, Buffer, Tables
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError

VALIDATION, TEST = SPLITS["validation"].start, SPLITS["test"].start


def draw_road(tables: Tables, grid: Buffer, key: int) -> tuple[int, int]:
    """Draw a road cell uniformly. Return it and the generator's next state."""
    cell = uniform_below(key, tables.cells) & INDEX_BITS
    while grid[cell] != ROAD_CELL:
        key = next_key(key)
        cell = uniform_below(key, tables.cells) & INDEX_BITS
    return cell, next_key(key)


def place_anywhere(tables: Tables, grid: Buffer, state: Buffer, key: int) -> None:
    """Place the deliveries, then the terrain, each on a random road cell."""
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
    """Add objects of these kinds to the shuffled ones on the first `covered` cells of a list.

    Each object takes one draw of the inside-out form of Durstenfeld's shuffle (Algorithm 235, CACM 1964): it takes a
    random cell among the first `covered` + 1, and the object there moves to the last of them. Return the generator's
    next state.
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
    """Place terrain and deliveries in a city with streets that cross at the start.

    The most frequent kind fills the city at first, so only the others are drawn.
    """
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
    # If the start is occupied now, its content moves to the street cell that was left out of the list.
    left_out = tables.city_cells[city + tables.blocks]
    move_parcel(tables, state, start, left_out)
    grid[left_out] = grid[start]
    grid[start] = DRONE_CELL


def move_parcel(tables: Tables, state: Buffer, cell: int, to: int) -> None:
    """If there is a parcel on a cell, record its move to another cell."""
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] == cell:
            state[i] = to


def draw_window(tables: Tables, seed: int, key: int) -> tuple[int, int]:
    """Draw a window of the terrain in the seed's split. Return it and the generator's next state."""
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
    """Draw a reachable road cell of fixed terrain. Return it and the generator's next state."""
    cell = open_cells[uniform_below(key, len(open_cells)) & INDEX_BITS]
    while grid[cell] != ROAD_CELL:
        key = next_key(key)
        cell = open_cells[uniform_below(key, len(open_cells)) & INDEX_BITS]
    return cell, next_key(key)


def place_on_terrain(tables: Tables, grid: Buffer, state: Buffer, seed: int, key: int) -> None:
    """Place start, deliveries and pads on fixed terrain: first the fixed ones, then one draw for each of the others."""
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
    """Write map `seed` into `grid` and `state`: start, deliveries and terrain, all on distinct cells."""
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
        task: The task of the map.
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
    """Generate the map of a task for a seed, or for the next draw of a random generator.

    Args:
        config: A task or its name.
        rng: A seed in [0, 2^53), or a `numpy.random.Generator` or `torch.Generator` that draws a train seed. Equal
            generator states give equal maps.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if `rng` is not a seed or a generator.
    """
    from drone_env.core.episode import Episode  # It imports this module.

    episode = Episode(config, seed=_seed_from(rng))
    grid, (x, y) = episode.grid(), episode.position
    grid[y, x] = episode.under
    return CityMap(episode.task, episode.seed, grid, (x, y), tuple((x, y) for x, y, _ in episode.parcels))


def _seed_from(rng: Any) -> int:
    stop = SPLITS["train"].stop
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(stop))
    torch = sys.modules.get("torch")  # a caller with a torch.Generator has imported torch
    if torch is not None and isinstance(rng, torch.Generator):
        return int(torch.randint(stop, (), generator=rng, device=rng.device, dtype=torch.int64))
    if isinstance(rng, SupportsIndex):
        return check_seed(rng)
    raise InvalidValueError(f"rng must be a seed, a numpy.random.Generator or a torch.Generator, got {rng!r}")
