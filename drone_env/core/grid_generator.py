"""Map generation: a map is a pure function of (task, version, seed)."""

import sys
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import Cell
from drone_env.core.rules import CELL, PARCELS, UNDER, Buffer, Rules, interpreted, row_size, view
from drone_env.core.seeds import SPLITS, check_seed, map_key, next_key, uniform_below
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError

ROAD = int(Cell.ROAD)
DRONE = int(Cell.DRONE)
DELIVERY = int(Cell.DELIVERY)
BUILDING = int(Cell.BUILDING)
TREE = int(Cell.TREE)


def belongs(rules: Rules, cell: int, kind: int, streets: int) -> bool:
    """Whether a kind may stand on a cell: buildings and trees between the streets, everything else on them.

    `streets` is a cell where two streets cross. In tasks without streets every kind may stand anywhere.
    """
    if rules.street_spacing == 0:
        return True
    across = (rules.columns[cell] - rules.columns[streets]) % rules.street_spacing
    down = (rules.lines[cell] - rules.lines[streets]) % rules.street_spacing
    return (across != 0 and down != 0) == (kind in (BUILDING, TREE))


def draw_road(rules: Rules, grid: Buffer, key: int, kind: int, streets: int) -> tuple[int, int]:
    """A cell for a kind that is still road, drawn uniformly, and the generator's state after the draw."""
    cell = uniform_below(key, rules.cells)
    while grid[cell] != ROAD or not belongs(rules, cell, kind, streets):
        key = next_key(key)
        cell = uniform_below(key, rules.cells)
    return cell, next_key(key)


def scatter(rules: Rules, grid: Buffer, row: Buffer, seed: int) -> None:
    """Write map `seed` into `grid` and `row`: start, deliveries, then each kind of terrain, all on distinct cells.

    The start lies where two streets cross, if there are streets.
    """
    for cell in range(rules.cells):
        grid[cell] = ROAD
    key = next_key(map_key(rules.key, seed))
    start = uniform_below(key, rules.cells)
    key = next_key(key)
    grid[start] = DRONE
    row[CELL] = start
    row[UNDER] = ROAD
    for i in range(rules.deliveries):
        cell, key = draw_road(rules, grid, key, DELIVERY, start)
        grid[cell] = DELIVERY
        row[PARCELS + i] = cell
    for kind in rules.placed:
        for _ in range(rules.counts[kind]):
            cell, key = draw_road(rules, grid, key, kind, start)
            grid[cell] = kind


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
    rules = interpreted(task)
    grid = np.zeros(rules.cells, np.uint8)
    row = np.zeros(row_size(rules), np.uint16)
    scatter(rules, view(grid), view(row), seed)
    grid[row[CELL]] = ROAD

    def position(cell: int) -> tuple[int, int]:
        return rules.columns[cell], rules.lines[cell]

    return CityMap(
        task=task,
        seed=seed,
        grid=np.reshape(grid, (task.height, task.width)),
        start=position(row[CELL]),
        deliveries=tuple(position(cell) for cell in row[PARCELS:]),
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
