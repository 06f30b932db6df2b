"""The batch, compiled, against single episodes, in plain Python: equal to the last bit, step by step."""

import os
from dataclasses import replace

import numpy as np
import pytest

from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.cells import Cell
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import MAX_SIDE, MAX_UNITS, TASKS, TaskConfig
from tests.parity.golden import Reference
from tests.property.test_episode import custom_task
from tests.unit.test_terrain import CELLS
from tests.unit.test_terrain import task as terrain_task

STEPS = int(os.environ.get("DRONE_ENV_PARITY_STEPS", "60000"))
"""Steps in all, over every combination of task and profile."""
HARD = TASKS["hard_delivery"]
CUSTOM = {f"custom {number}": custom_task(number) for number in range(8)}
CITY = np.tile(np.reshape(np.frombuffer(CELLS, np.uint8), (3, 5)), (2, 6))
CITY[:, -1] = Cell.PAD
CUSTOM |= {
    "terrain": terrain_task(pads=2, battery_capacity=18),
    "windows": terrain_task(CITY.tobytes(), columns=30, pads=2, battery_capacity=18),
    "start": terrain_task(start=(2, 2)),
    "parcels": terrain_task(parcels=((0, 0), (2, 1))),
}
LARGEST = replace(
    HARD,
    width=MAX_SIDE,
    height=MAX_SIDE,
    deliveries=16,
    buildings=900,
    pads=900,
    max_steps=MAX_UNITS,
    battery_capacity=MAX_UNITS,
    drain=((Cell.BUILDING, MAX_UNITS),),
    charge_rate=MAX_UNITS,
)
ALL_TASKS = {**TASKS, **CUSTOM}
CASES = [(task, profile, number % 2 == 1) for task in ALL_TASKS for number, profile in enumerate(REWARD_PROFILES)]
"""Each task in both modes of a reset: they do not depend on what a step pays."""
SHARE = STEPS // len(CASES)
N = 16
EDGES = [edge for start, stop in SPLITS.values() for edge in (start, stop - 1)]


def assert_equal(reference: Reference, batch: Batch) -> None:
    """Bit by bit: rewards and telemetry are compared as bytes, so that 0.0 is not -0.0."""
    state = batch.get_state()
    for name, array in reference.get_state().items():
        assert state[name].tobytes() == array.tobytes(), name
    assert batch.grids.tobytes() == state["grids"].tobytes()
    assert batch.action_masks.tobytes() == reference.action_masks.tobytes()
    assert batch.seeds.tobytes() == reference.seeds.tobytes()
    assert batch.rewards.tobytes() == reference.rewards.tobytes()
    assert batch.terminated.tobytes() == reference.terminated.tobytes()
    numbers = [batch.finals()[name].tolist() for name in ("score", "steps", "deliveries", "seed")]
    seen = map(bytes, batch.final_grids), map(bytes, batch.final_telemetry)
    assert list(zip(batch.ended.tolist(), *numbers, *seen, strict=True)) == reference.finals


def assert_parity(task: TaskConfig, profile: str, same_step: bool, steps: int, n: int = N) -> None:
    """For so many steps, and until as many episodes have ended as fly together."""
    rng = np.random.default_rng(len(profile) + task.width)
    batch = Batch(task, n, profile, same_step=same_step)
    reference = Reference(task, n, profile, same_step)
    seeds = rng.integers(2**53, size=n)
    seeds[: len(EDGES)] = EDGES
    batch.reset(seeds)
    reference.reset(seeds.tolist())
    assert_equal(reference, batch)
    ended = flown = 0
    while flown < steps or ended < n:
        # Straight legs reach further than single random steps.
        actions = rng.integers(N_ACTIONS, size=n)
        for _ in range(rng.integers(1, 4)):
            batch.step(actions)
            reference.step(actions.tolist())
            assert_equal(reference, batch)
            flown += n
            ended += len(reference.finals)


@pytest.mark.parametrize(("task", "profile", "same_step"), CASES)
def test_compiled_together_and_interpreted_one_by_one_agree_to_the_last_bit(
    task: str, profile: str, same_step: bool
) -> None:
    assert_parity(ALL_TASKS[task], profile, same_step, SHARE)


def test_so_they_do_where_every_number_is_the_highest_allowed() -> None:
    assert_parity(LARGEST, "aligned", True, SHARE, n=8)
