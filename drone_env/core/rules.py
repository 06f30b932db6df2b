"""A task as tables, and the layout of an episode's state.

`tabulate(task)` turns a `TaskConfig` into small tables once; a step then only looks things up, so a new number or
mechanic is a new entry and not a new branch. The same tables serve compiled code (as NumPy arrays) and interpreted
code (as memory views, whose items are plain Python integers).

The state of one episode is two buffers:

- `grid`: one cell id per cell, row by row (cell number = y * width + x), as the drone sees it: its own id hides what
  lies below it.
- `row`: the integers named below, then one entry per delivery: its cell number, plus `DELIVERED_FLAG` once it has been
  delivered. They are unsigned 16-bit integers: compiled code then needs no care for indices below zero.
"""

from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import ACTION_OFFSETS, N_ACTIONS, Action, Event
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.seeds import task_key
from drone_env.core.tasks import TERRAIN, TaskConfig

Buffer: TypeAlias = "memoryview[int]"
"""A buffer of integers: a memory view when interpreted, a NumPy array when compiled."""
FloatBuffer: TypeAlias = "memoryview[float]"
"""The same, of floating-point numbers."""

N_TERRAIN = len(TERRAIN)

Tables = TypeVar("Tables", bound=tuple[Any, ...])

CELL = 0
"""Where the drone is."""
UNDER = 1
"""The kind of the cell below it."""
STEPS = 2
"""Steps taken."""
BATTERY = 3
"""Battery units left."""
DELIVERIES = 4
"""Parcels delivered."""
TARGET = 5
"""Cell of the current target, or `NOWHERE` when none is left."""
DISTANCE = 6
"""Manhattan distance to the current target; 0 when none is left."""
EVENT = 7
"""What the last step came to (`Event`)."""
OUTCOME = 8
"""How the episode stands (`Outcome`)."""
PARCELS = 9
"""From here on: one entry per delivery."""

NOWHERE = (1 << 16) - 1
"""Stands for a cell that does not exist: off the grid, or no target left."""
DELIVERED_FLAG = 1 << 15
"""Added to the cell of a parcel that has been delivered."""


class Rules(NamedTuple):
    """A task's tables. Arrays when compiled, memory views when interpreted; `cells` is width * height."""

    key: int
    """Sets this task's maps apart from those of others."""
    width: int
    height: int
    cells: int
    deliveries: int
    max_steps: int
    capacity: int
    columns: Buffer
    """x of each cell, int16[cells]."""
    lines: Buffer
    """y of each cell, int16[cells]."""
    moves: Buffer
    """Cell reached from `cell` by `action`, `NOWHERE` at the wall: uint16[cells * 5], at
    cell * N_ACTIONS + action."""
    open_moves: Buffer
    """The actions that do not meet the wall, 1 in byte `action` of each int64[cells]."""
    any_impassable: int
    """1 if some kind of cell is impassable."""
    passable: Buffer
    """Whether the drone can enter a kind of cell, uint8[kinds]."""
    drain: Buffer
    """Battery units that an action costs above a kind of cell, below zero where it charges: int16[kinds * 5], at
    kind * N_ACTIONS + action."""
    flight_event: Buffer
    """The event of an action that ends above a kind of cell, if nothing else happened: uint8[kinds * 5], laid
    out alike."""
    street_spacing: int
    """Every how many rows and columns there is a street; 0 where everything lies anywhere."""
    blocks: int
    """How many cells lie between the streets."""
    city_grids: Buffer
    """The map before anything is drawn, for each way in which the streets can lie: uint8[ways * cells]."""
    city_cells: Buffer
    """The cells between the streets, then those on them, in each of these ways: uint16[ways * cells]."""
    drawn_kinds: Buffer
    """The kinds of cell that are drawn where there are streets, in the order in which they are: uint8[draws]."""
    drawn_first: Buffer
    """Where in `city_cells` the cells begin that such a draw chooses among: uint16[draws + deliveries]."""
    drawn_among: Buffer
    """How many cells they are: uint16[draws + deliveries]."""
    drawn_own: Buffer
    """The last of these cells."""
    efficiency_needs_all: int
    """1 if battery and steps left count in the score only when everything is delivered."""
    counts: Buffer
    """How many cells of a kind a map holds, int16[kinds]; `placed` says in which order they are placed."""
    placed: Buffer
    """Kinds in the order in which they are placed on the map, uint8[...]."""
    telemetry_size: int
    """Values in the telemetry: 5, 6 with the share of steps left, 13 with the kind of the cell below as well."""
    x_share: FloatBuffer
    """x / width of each cell, float32[cells]."""
    y_share: FloatBuffer
    """y / height of each cell, float32[cells]."""
    battery_share: FloatBuffer
    """units / capacity for each number of units, float32[capacity + 1]."""
    steps_share: FloatBuffer
    """Share of steps left after each number of steps, float32[max_steps + 1]."""
    below: FloatBuffer
    """1 for the kind itself, 0 for every other that can lie below the drone: float32[kinds * 7], at
    kind * N_TERRAIN + number of the other in `TERRAIN`."""


def row_size(rules: Rules) -> int:
    """Length of an episode's `row`."""
    return PARCELS + rules.deliveries


@lru_cache(maxsize=64)
def tabulate(task: TaskConfig) -> Rules:
    """The task's tables as NumPy arrays, for compiled code. Shared: do not write to them."""
    width, height = task.width, task.height
    cells = width * height
    moves = np.full((height, width, N_ACTIONS), NOWHERE, np.uint16)
    for y in range(height):
        for x in range(width):
            for action, (dx, dy) in ACTION_OFFSETS.items():
                if 0 <= x + dx < width and 0 <= y + dy < height:
                    moves[y, x, action] = (y + dy) * width + x + dx

    passable = np.ones(N_CELL_KINDS, np.uint8)
    passable[list(task.impassable)] = 0
    drain = np.ones((N_CELL_KINDS, N_ACTIONS), np.int16)
    for kind, units in task.drain:
        drain[kind] = units
    if task.charge_rate:
        drain[Cell.PAD, Action.WAIT] = -task.charge_rate
    flight_event = np.full((N_CELL_KINDS, N_ACTIONS), Event.STEP, np.uint8)
    flight_event[:, Action.WAIT] = Event.WAIT
    flight_event[Cell.OBSTACLE] = Event.OBSTACLE
    flight_event[Cell.BUILDING] = Event.BUILDING
    flight_event[Cell.TREE] = Event.TREE
    counts = np.zeros(N_CELL_KINDS, np.int16)
    for kind, count in task.cell_counts().items():
        counts[kind] = count
    below = np.zeros((N_CELL_KINDS, N_TERRAIN), np.float32)
    below[list(TERRAIN), np.arange(N_TERRAIN)] = 1

    numbers = np.arange(cells, dtype=np.int16)
    tables: dict[str, Any] = {
        "key": task_key(task.id, task.version),
        "width": width,
        "height": height,
        "cells": cells,
        "deliveries": task.deliveries,
        "max_steps": task.max_steps,
        "capacity": task.battery_capacity,
        "columns": numbers % width,
        "lines": numbers // width,
        "moves": np.ravel(moves),
        "open_moves": (np.reshape(moves != NOWHERE, (cells, N_ACTIONS)) << 8 * np.arange(N_ACTIONS)).sum(axis=1),
        "any_impassable": int(not passable.all()),
        "passable": passable,
        "drain": np.ravel(drain),
        "flight_event": np.ravel(flight_event),
        "street_spacing": task.street_spacing,
        **_city_tables(task),
        "efficiency_needs_all": int(task.efficiency_needs_all),
        "counts": counts,
        "placed": np.array(list(task.cell_counts()), np.uint8),
        "telemetry_size": task.telemetry_size,
        "x_share": (numbers % width / width).astype(np.float32),
        "y_share": (numbers // width / height).astype(np.float32),
        "battery_share": (np.arange(task.battery_capacity + 1) / task.battery_capacity).astype(np.float32),
        "steps_share": (np.arange(task.max_steps, -1, -1) / task.max_steps).astype(np.float32),
        "below": np.ravel(below),
    }
    return read_only(Rules(**tables))


def _city_tables(task: TaskConfig) -> dict[str, Any]:
    """What maps with streets are drawn from; empty tables where there are none.

    Of the kinds that stand between the streets (open ground among them), and of those on the streets, the most
    frequent one covers all at first, and the others are drawn: the fewest draws that do.
    """
    spacing, cells = max(task.street_spacing, 1), task.width * task.height
    ways = spacing**2 if task.street_spacing else 0
    numbers = np.arange(cells)
    across, down = numbers % task.width % spacing, numbers // task.width % spacing
    way = np.arange(ways)[:, None]
    on_street = (across == way % spacing) | (down == way // spacing)
    blocks = (task.width - task.width // spacing) * (task.height - task.height // spacing)

    counts = task.cell_counts()
    streets = cells - blocks - 1 - task.deliveries  # without the start and the parcels
    between = {kind: counts[kind] for kind in (Cell.BUILDING, Cell.TREE)}
    along = {kind: counts[kind] for kind in (Cell.OBSTACLE, Cell.PAD)}
    between[Cell.ROAD], along[Cell.ROAD] = blocks - sum(between.values()), streets - sum(along.values())
    covers: list[Cell] = []
    kinds: list[Cell] = []
    among: list[int] = []
    for placed, size in (between, blocks), (along, streets):
        cover, *rest = sorted(placed, key=lambda kind: (-placed[kind], kind))
        covers.append(cover)
        drawn = [kind for kind in rest for _ in range(placed[kind])]
        kinds += drawn
        among += range(size - len(drawn) + 1, size + 1)
    among += range(streets + 1, streets + 1 + task.deliveries)
    n_between = blocks - between[covers[0]]
    # The first cell on the streets is kept back: it stands in for the start where that would be drawn.
    first = [0] * n_between + [blocks + 1] * (len(among) - n_between)
    return {
        "blocks": blocks,
        "city_grids": np.ravel(np.where(on_street, *reversed(covers))).astype(np.uint8),
        "city_cells": np.ravel(np.argsort(on_street, axis=1, kind="stable")).astype(np.uint16),
        "drawn_kinds": np.array(kinds if ways else [], np.uint8),
        "drawn_first": np.array(first if ways else [], np.uint16),
        "drawn_among": np.array(among if ways else [], np.uint16),
        "drawn_own": np.array([f + n - 1 for f, n in zip(first, among)] if ways else [], np.uint16),
    }


@lru_cache(maxsize=64)
def interpreted(task: TaskConfig) -> Rules:
    """The same tables as memory views, for interpreted code."""
    return as_views(tabulate(task))


def view(array: npt.NDArray[Any]) -> Any:
    """The memory of an array as a memory view, whose items are plain Python numbers and fast to get at."""
    memory: Any = array
    return memoryview(memory)


def as_views(tables: Tables) -> Tables:
    """A named tuple of tables with a memory view for each array."""
    items: tuple[Any, ...] = tables
    return type(tables)(*(view(item) if hasattr(item, "dtype") else item for item in items))


def read_only(tables: Tables) -> Tables:
    """The same named tuple, its arrays closed to writing."""
    for table in tables:
        if isinstance(table, np.ndarray):
            table.setflags(write=False)
    return tables
