"""What an agent sees beside the grid, written into buffers that the caller owns."""

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.obstacles import collision
from drone_env.core.rules import BATTERY, CELL, NOWHERE, STEPS, TARGET, Buffer, FloatBuffer, Rules

FREE = int(Event.NONE)


def write_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """Write drone x/width, y/height, battery/capacity, target x/width, y/height into float32[5].

    Where nothing is left to deliver, the drone's own position stands for the target. Tasks whose battery does not
    tell the time have a sixth value: the share of steps left.
    """
    write_own_telemetry(rules, row, telemetry)
    write_target_telemetry(rules, row, telemetry)


def write_own_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """The part that every step changes: position, battery, steps left."""
    telemetry[0] = rules.x_share[row[CELL]]
    telemetry[1] = rules.y_share[row[CELL]]
    telemetry[2] = rules.battery_share[row[BATTERY]]
    if rules.telemetry_size > 5:
        telemetry[5] = rules.steps_share[row[STEPS]]


def write_target_telemetry(rules: Rules, row: Buffer, telemetry: FloatBuffer) -> None:
    """The part that only a delivery or a reset changes: the target."""
    target = row[TARGET] if row[TARGET] != NOWHERE else row[CELL]
    telemetry[3] = rules.x_share[target]
    telemetry[4] = rules.y_share[target]


def write_action_mask(rules: Rules, grid: Buffer, row: Buffer, mask: Buffer) -> None:
    """Write into int8[5] 1 for each action that moves or waits, 0 for each that would bump. Advice, never enforced."""
    first = row[CELL] * N_ACTIONS
    for action in range(N_ACTIONS):
        mask[action] = rules.open_moves[first + action]
    if rules.any_impassable:
        for action in range(N_ACTIONS):
            if collision(rules, grid, row, action) != FREE:
                mask[action] = 0
