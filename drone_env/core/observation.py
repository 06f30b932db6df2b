"""What an agent sees; all but the grid is written into buffers that the caller owns."""

from typing import TypedDict

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.obstacles import collision
from drone_env.core.rules import BATTERY, CELL, N_TERRAIN, NOWHERE, STEPS, TARGET, UNDER, Buffer, FloatBuffer, Rules

FREE = int(Event.NONE)


class Observation(TypedDict):
    """What an agent acts on."""

    grid: npt.NDArray[np.uint8]
    """uint8[height, width] of cell ids; the drone's id hides what lies below it."""
    telemetry: npt.NDArray[np.float32]
    """float32[5] (or 6, or 13): see `write_telemetry`."""


def write_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """Write drone x/width, y/height, battery/capacity, target x/width, y/height into float32[5].

    Where nothing is left to deliver, the drone's own position stands for the target. Tasks whose battery does not
    tell the time have a sixth value: the share of steps left. Tasks with pads have it too, and then seven more, of
    which one is 1: that of the kind of the cell below the drone, in the order of `tasks.TERRAIN`.
    """
    write_own_telemetry(rules, row, telemetry)
    write_target_telemetry(rules, row, telemetry)


def write_own_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """The part that every step changes: position, battery, steps left, the cell below."""
    telemetry[0] = rules.x_share[row[CELL]]
    telemetry[1] = rules.y_share[row[CELL]]
    telemetry[2] = rules.battery_share[row[BATTERY]]
    if rules.telemetry_size > 5:
        telemetry[5] = rules.steps_share[row[STEPS]]
    if rules.telemetry_size > 6:
        for i in range(N_TERRAIN):
            telemetry[6 + i] = rules.below[row[UNDER] * N_TERRAIN + i]


def write_target_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """The part that only a delivery or a reset changes: the target."""
    target = row[TARGET] if row[TARGET] != NOWHERE else row[CELL]
    telemetry[3] = rules.x_share[target]
    telemetry[4] = rules.y_share[target]


def open_actions(rules: Rules, grid: Buffer, row: Buffer) -> int:
    """The actions that do not bump: 1 in byte `action` of an integer. Advice, never enforced."""
    mask = rules.open_moves[row[CELL]]
    if rules.any_impassable:
        for action in range(N_ACTIONS):
            to = rules.moves[row[CELL] * N_ACTIONS + action]
            if to != NOWHERE and collision(rules, grid, to) != FREE:
                mask -= 1 << 8 * action
    return mask
