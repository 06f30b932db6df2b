"""Observations. The caller owns the buffers that receive the telemetry."""

from typing import TypedDict

import numpy as np
import numpy.typing as npt

from drone_env.core.tables import (
    BATTERY,
    CELL,
    N_MOVES,
    N_TERRAIN,
    NOWHERE,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    FloatBuffer,
    Tables,
    interpreted,
    state_size,
    view,
)
from drone_env.core.tasks import TaskConfig


class Observation(TypedDict):
    """The observation of an agent."""

    grid: npt.NDArray[np.uint8]
    """uint8[height, width] of cell ids; the drone's id hides the cell below it."""
    telemetry: npt.NDArray[np.float32]
    """float32[5], [6] or [13]: see `write_telemetry`."""


def telemetry_of(
    task: TaskConfig, cell: int, under: int, battery: int, steps: int, target: int | None
) -> npt.NDArray[np.float32]:
    """The telemetry of a drone with these fields, as `write_telemetry` writes it.

    Args:
        task: The task.
        cell: Cell of the drone, y * width + x.
        under: The kind of the cell below it.
        battery: Units left.
        steps: Steps taken.
        target: The cell of the current target; None if nothing is left to deliver.
    """
    tables = interpreted(task)
    state = np.zeros(state_size(tables), np.uint16)
    state[[CELL, UNDER, BATTERY, STEPS]] = cell, under, battery, steps
    state[TARGET] = NOWHERE if target is None else target
    telemetry = np.zeros(task.telemetry_size, np.float32)
    write_telemetry(tables, view(state), view(telemetry))
    return telemetry


def write_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write drone x/width, y/height, battery/capacity, target x/width, y/height into float32[5].

    If nothing is left to deliver, the target is the drone's own position. A sixth value is the fraction of steps left,
    if the battery does not show it. Tasks with pads have this value, and then seven more: the one-hot kind of the cell
    below the drone, in the order of `tasks.TERRAIN`.
    """
    write_own_telemetry(tables, state, telemetry)
    write_target_telemetry(tables, state, telemetry)


def write_own_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write the part that every step changes: position, battery, steps left, the cell below."""
    at = 2 * state[CELL]
    x, y, battery = tables.shares[at], tables.shares[at + 1], tables.battery_share[state[BATTERY]]
    telemetry[0], telemetry[1], telemetry[2] = x, y, battery
    if tables.telemetry_size > 5:
        telemetry[5] = tables.steps_share[state[STEPS]]
    if tables.telemetry_size > 6:
        for i in range(6, 6 + N_TERRAIN):
            telemetry[i] = 0.0
        telemetry[6 + tables.terrain_numbers[state[UNDER]]] = 1.0


def write_target_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write the part that only a delivery or a reset changes: the target."""
    target = state[TARGET] if state[TARGET] != NOWHERE else state[CELL]
    telemetry[3], telemetry[4] = tables.shares[2 * target], tables.shares[2 * target + 1]


def open_actions(tables: Tables, grid: Buffer, state: Buffer) -> int:
    """The actions that do not bump, as an integer with 1 in byte `action`. Not enforced."""
    mask = tables.open_moves[state[CELL]]
    if tables.any_impassable:
        for action in range(N_MOVES):
            mask -= tables.impassable[grid[tables.around[state[CELL] * N_MOVES + action]]] << 8 * action
    return mask
