"""Compiled and interpreted, the same functions give the same bits."""

import random
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drone_env.core import compiled
from drone_env.core.cells import Cell
from drone_env.core.rewards import REWARD_PROFILES, get_reward_profile, tabulate_rewards
from drone_env.core.rules import OUTCOME, row_size, tabulate
from drone_env.core.seeds import N_SEEDS, SPLITS
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import MAX_UNITS, TASKS, TaskConfig

N_STEPS = 720
"""Per task and profile: 28 pairs make 20,000 steps in all."""

HARD = TASKS["hard_delivery"]
CUSTOM = {
    "drain": replace(HARD, drain=((Cell.TREE, 7), (Cell.BUILDING, 0), (Cell.DELIVERED, 3)), max_steps=90),
    "pads": replace(
        HARD, width=5, height=8, buildings=5, trees=4, obstacles=3, pads=9, charge_rate=6, battery_capacity=12
    ),
    "impassable": replace(
        HARD, width=9, height=6, impassable=frozenset({Cell.BUILDING, Cell.OBSTACLE}), buildings=9, battery_capacity=99
    ),
    "largest": replace(
        HARD,
        width=64,
        height=64,
        deliveries=16,
        buildings=900,
        pads=900,
        max_steps=MAX_UNITS,
        battery_capacity=MAX_UNITS,
        drain=((Cell.BUILDING, MAX_UNITS),),
        charge_rate=MAX_UNITS,
    ),
}
ALL_TASKS = {**TASKS, **CUSTOM}


def bits(number: Any) -> bytes:
    return struct.pack("<d", number)


@pytest.mark.parametrize("profile", REWARD_PROFILES)
@pytest.mark.parametrize("task", ALL_TASKS.values(), ids=ALL_TASKS)
def test_states_and_rewards_agree_to_the_last_bit(task: TaskConfig, profile: str) -> None:
    rules, rewards = tabulate(task), tabulate_rewards(task, get_reward_profile(profile))
    grid, row = np.zeros(rules.cells, np.uint8), np.zeros(row_size(rules), np.uint16)
    episode = Episode(task, profile)
    draw = random.Random(f"{task.id} {profile}")
    row[OUTCOME] = 1
    for _ in range(N_STEPS):
        if row[OUTCOME]:
            seed = draw.randrange(N_SEEDS)
            compiled.reset(rules, grid, row, seed)
            episode.reset(seed)
        else:
            action = draw.randrange(5)
            reward = compiled.step(rules, rewards, grid, row, action)
            assert bits(reward) == bits(episode.step(action))
        state = episode.get_state()
        assert (state.grid, state.row) == (grid.tobytes(), row.tobytes())


@pytest.mark.parametrize("task", ALL_TASKS.values(), ids=ALL_TASKS)
def test_maps_agree_at_the_edges_of_the_splits(task: TaskConfig) -> None:
    rules = tabulate(task)
    grid, row = np.zeros(rules.cells, np.uint8), np.zeros(row_size(rules), np.uint16)
    episode = Episode(task)
    for seed in [edge for start, stop in SPLITS.values() for edge in (start, stop - 1)]:
        compiled.reset(rules, grid, row, seed)
        episode.reset(seed)
        state = episode.get_state()
        assert (state.grid, state.row) == (grid.tobytes(), row.tobytes())


def test_a_step_after_the_end_changes_nothing() -> None:
    task = replace(TASKS["easy_delivery"], max_steps=1)
    rules, rewards = tabulate(task), tabulate_rewards(task, get_reward_profile("tiered"))
    grid, row = np.zeros(rules.cells, np.uint8), np.zeros(row_size(rules), np.uint16)
    compiled.reset(rules, grid, row, 0)
    compiled.step(rules, rewards, grid, row, 4)
    before = grid.tobytes(), row.tobytes()
    for action in range(5):
        assert compiled.step(rules, rewards, grid, row, action) == 0
    assert (grid.tobytes(), row.tobytes()) == before
