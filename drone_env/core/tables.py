"""A task as tables, and the layout of an episode's state.

`tabulate(task)` converts a `TaskConfig` into small tables. A step only looks values up, so a new mechanic is a new
entry, not a new branch. Compiled code uses the tables as NumPy arrays, interpreted code as memory views, because their
items are plain Python integers.

Two buffers contain the state of one episode:

- `grid`: one cell id per cell, row by row (cell number = y * width + x), as the drone sees it: the drone's own id hides
  the cell below it.
- `state`: the integers below, then one entry per parcel: its cell number, plus `DELIVERED_FLAG` after its delivery. The
  type is uint16, because compiled code is slower if an index may be negative.
"""

from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import ACTION_OFFSETS, N_ACTIONS, Action, Event
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.seeds import task_key
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.core.terrain import Terrain

Buffer: TypeAlias = "memoryview[int]"
"""A buffer of integers: a memory view for interpreted code, a NumPy array for compiled code."""
FloatBuffer: TypeAlias = "memoryview[float]"
"""A buffer of floating-point numbers."""

INDEX_BITS = (1 << 16) - 1
"""A mask that does not change indices of tables. It shows the compiler that they are not negative."""
N_MOVES = N_ACTIONS - 1
"""All actions except WAIT, which is the last."""
N_TERRAIN = len(TERRAIN)

AnyTables = TypeVar("AnyTables", bound=tuple[Any, ...])

CELL = 0
"""Cell of the drone."""
UNDER = 1
"""The kind of the cell below it."""
STEPS = 2
"""Steps taken."""
BATTERY = 3
"""Battery units left."""
DELIVERIES_DONE = 4
"""Parcels delivered."""
TARGET = 5
"""Cell of the current target, or `NOWHERE` if none is left."""
DISTANCE = 6
"""Manhattan distance to the current target; 0 if none is left."""
EVENT = 7
"""Event of the last step (`Event`)."""
OUTCOME = 8
"""Outcome of the episode (`Outcome`)."""
PARCELS = 9
"""The first of the entries of the parcels."""

NOWHERE = (1 << 16) - 1
"""The cell number for off the grid or no target."""
DELIVERED_FLAG = 1 << 15
"""Added to the cell of a delivered parcel."""


class Tables(NamedTuple):
    """A task's tables: arrays for compiled code, memory views for interpreted code. `cells` is width * height."""

    key: int
    """Key of the random numbers of this task's maps."""
    width: int
    height: int
    cells: int
    deliveries: int
    max_steps: int
    capacity: int
    columns: Buffer
    """x of each cell, int64[cells]."""
    rows: Buffer
    """y of each cell, int64[cells]."""
    moves: Buffer
    """Cell after `action` from `cell`, `NOWHERE` at the wall: uint16[cells * 5], at cell * N_ACTIONS + action."""
    open_moves: Buffer
    """The actions that do not hit the wall: 1 in byte `action` of each int64[cells]."""
    around: Buffer
    """Cell after each move, the cell itself at the wall: uint16[cells * 4], at cell * N_MOVES + action."""
    any_impassable: int
    """1 if some kind of cell is impassable."""
    impassable: Buffer
    """1 for kinds of cell that the drone cannot enter, uint8[kinds]."""
    drain: Buffer
    """Battery units that an action costs above a kind of cell, negative if it charges: int16[kinds * 5], at
    kind * N_ACTIONS + action."""
    flight_event: Buffer
    """The event of an action that ends above a kind of cell, if no other event applies: uint8[kinds * 5], in the same
    layout."""
    street_spacing: int
    """Distance between parallel streets; 0 if there are no streets."""
    blocks: int
    """The number of cells between the streets."""
    city_grids: Buffer
    """The map before the first draw, for each position of the streets or each window of fixed terrain:
    uint8[positions * cells]."""
    city_cells: Buffer
    """The cells between the streets, then those on them, for each position: uint16[positions * cells]. With fixed
    terrain, the cells for start, parcels and pads, window by window."""
    windows: Buffer
    """With fixed terrain, the first window of each split and the end of its windows, int64[splits * 2]; else empty."""
    window_cells: Buffer
    """The first index of each window in `city_cells`, and the end of the last one: int64[windows + 1]."""
    window_pads: Buffer
    """The number of pads in each window: int64[windows]."""
    fixed: Buffer
    """With fixed terrain, the cell of the start and of each parcel (`NOWHERE` if it is random), uint16[1 +
    deliveries]; else empty."""
    drawn_kinds: Buffer
    """The kind of terrain of each draw, in order: uint8[draws]."""
    drawn_between: int
    """The number of draws between the streets; they come first."""
    efficiency_needs_all: int
    """1 if battery and steps left count in the score only if everything is delivered."""
    telemetry_size: int
    """Values in the telemetry: 5, 6 with the fraction of steps left, 13 with the kind of the cell below as well."""
    shares: FloatBuffer
    """x / width and y / height of each cell: float32[cells * 2], at cell * 2."""
    battery_share: FloatBuffer
    """units / capacity for each number of units, float32[capacity + 1]."""
    steps_share: FloatBuffer
    """Fraction of steps left after each number of steps, float32[max_steps + 1]."""
    terrain_numbers: Buffer
    """The index of a kind in `TERRAIN`: uint8[kinds]."""


def state_size(tables: Tables) -> int:
    """Length of the state of an episode."""
    return PARCELS + tables.deliveries


@lru_cache(maxsize=64)
def tabulate(task: TaskConfig) -> Tables:
    """The task's tables as read-only NumPy arrays, for compiled code."""
    tables: dict[str, Any] = {
        "key": task_key(task.id + (f"/{task.terrain.digest()}" if task.terrain else ""), task.version),
        "width": task.width,
        "height": task.height,
        "cells": task.width * task.height,
        "deliveries": task.deliveries,
        "max_steps": task.max_steps,
        "capacity": task.battery_capacity,
        "efficiency_needs_all": int(task.efficiency_needs_all),
        "street_spacing": task.street_spacing,
        **_move_tables(task),
        **_kind_tables(task),
        **_city_tables(task),
        **_telemetry_tables(task),
    }
    return read_only(Tables(**tables))


def _move_tables(task: TaskConfig) -> dict[str, Any]:
    """The positions of the cells, and where actions lead."""
    cells = np.arange(task.width * task.height)
    columns, rows = cells % task.width, cells // task.width
    moves = np.full((len(cells), N_ACTIONS), NOWHERE, np.uint16)
    for action, (dx, dy) in ACTION_OFFSETS.items():
        x, y = columns + dx, rows + dy
        inside = (0 <= x) & (x < task.width) & (0 <= y) & (y < task.height)
        moves[inside, action] = (y * task.width + x)[inside]
    return {
        "columns": columns,
        "rows": rows,
        "moves": np.ravel(moves),
        "open_moves": ((moves != NOWHERE) << 8 * np.arange(N_ACTIONS)).sum(axis=1),
        "around": np.ravel(np.where(moves == NOWHERE, cells[:, None], moves)[:, :N_MOVES]).astype(np.uint16),
    }


def _kind_tables(task: TaskConfig) -> dict[str, Any]:
    """The effect of each kind of cell on a drone that enters it or is above it."""
    impassable = np.zeros(N_CELL_KINDS, np.uint8)
    impassable[list(task.impassable)] = 1
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
    return {
        "any_impassable": int(impassable.any()),
        "impassable": impassable,
        "drain": np.ravel(drain),
        "flight_event": np.ravel(flight_event),
    }


def _telemetry_tables(task: TaskConfig) -> dict[str, Any]:
    """The values of telemetry."""
    cells = np.arange(task.width * task.height)
    shares = np.column_stack([cells % task.width / task.width, cells // task.width / task.height])
    terrain_numbers = np.zeros(N_CELL_KINDS, np.uint8)
    terrain_numbers[list(TERRAIN)] = np.arange(N_TERRAIN)
    return {
        "telemetry_size": task.telemetry_size,
        "shares": np.ravel(shares).astype(np.float32),
        "battery_share": (np.arange(task.battery_capacity + 1) / task.battery_capacity).astype(np.float32),
        "steps_share": (np.arange(task.max_steps, -1, -1) / task.max_steps).astype(np.float32),
        "terrain_numbers": terrain_numbers,
    }


def _city_tables(task: TaskConfig) -> dict[str, Any]:
    """The tables for map generation.

    With streets, the most frequent kind between them and the most frequent kind on them fill the map at first. The
    other kinds are drawn. This takes the fewest draws.
    """
    counts, spacing, cells = task.cell_counts(), task.street_spacing, task.width * task.height
    if task.terrain is not None:
        return _terrain_tables(task, task.terrain)
    tables: dict[str, Any] = {
        "blocks": 0,
        "city_grids": np.zeros(0, np.uint8),
        "city_cells": np.zeros(0, np.uint16),
        "windows": np.zeros(0, np.int64),
        "window_cells": np.zeros(0, np.int64),
        "window_pads": np.zeros(0, np.int64),
        "fixed": np.zeros(0, np.uint16),
        "drawn_kinds": np.array([kind for kind, count in counts.items() for _ in range(count)], np.uint8),
        "drawn_between": 0,
    }
    if spacing == 0:
        return tables
    numbers, position = np.arange(cells), np.arange(spacing**2)[:, None]
    across, down = numbers % task.width % spacing, numbers // task.width % spacing
    on_street = (across == position % spacing) | (down == position // spacing)
    blocks = (task.width - task.width // spacing) * (task.height - task.height // spacing)

    between = {kind: counts[kind] for kind in (Cell.BUILDING, Cell.TREE)}
    along = {kind: counts[kind] for kind in (Cell.OBSTACLE, Cell.PAD)}
    between[Cell.ROAD] = blocks - sum(between.values())
    along[Cell.ROAD] = cells - blocks - 1 - task.deliveries - sum(along.values())
    fillers: list[Cell] = []
    kinds: list[Cell] = []
    for placed in between, along:
        filler, *others = sorted(placed, key=lambda kind: (-placed[kind], kind))
        fillers.append(filler)
        kinds += [kind for kind in others for _ in range(placed[kind])]
    return tables | {
        "blocks": blocks,
        "city_grids": np.ravel(np.where(on_street, fillers[1], fillers[0])).astype(np.uint8),
        "city_cells": np.ravel(np.argsort(on_street, axis=1, kind="stable")).astype(np.uint16),
        "drawn_kinds": np.array(kinds, np.uint8),
        "drawn_between": blocks - between[fillers[0]],
    }


def _terrain_tables(task: TaskConfig, terrain: Terrain) -> dict[str, Any]:
    """The tables for map generation on fixed terrain."""
    stops = [terrain.start, *(terrain.parcels or [None] * task.deliveries)]
    windows = [window for split in task.windows.values() for window in split]
    ends = np.cumsum([0, *map(len, task.windows.values())])
    return {
        "blocks": 0,
        "city_grids": np.frombuffer(b"".join(window.cells for window in windows), np.uint8).copy(),
        "city_cells": np.concatenate([np.array(window.drawn, np.uint16) for window in windows]),
        "windows": np.ravel(np.column_stack([ends[:-1], ends[1:]])),
        "window_cells": np.cumsum([0, *(len(window.drawn) for window in windows)]),
        "window_pads": np.array([window.pads for window in windows], np.int64),
        "fixed": np.array([NOWHERE if at is None else at[1] * task.width + at[0] for at in stops], np.uint16),
        "drawn_kinds": np.full(task.pads, Cell.PAD, np.uint8),
        "drawn_between": 0,
    }


@lru_cache(maxsize=64)
def interpreted(task: TaskConfig) -> Tables:
    """The same tables as memory views, for interpreted code."""
    return as_views(tabulate(task))


def view(array: npt.NDArray[Any]) -> Any:
    """A memory view of an array: its items are plain Python numbers, and access is fast."""
    memory: Any = array
    return memoryview(memory)


def as_views(tables: AnyTables) -> AnyTables:
    """The same named tuple with a memory view of each array."""
    items: tuple[Any, ...] = tables
    return type(tables)(*(view(item) if hasattr(item, "dtype") else item for item in items))


def read_only(tables: AnyTables) -> AnyTables:
    """The same named tuple with read-only arrays."""
    for table in tables:
        if isinstance(table, np.ndarray):
            table.setflags(write=False)
    return tables
