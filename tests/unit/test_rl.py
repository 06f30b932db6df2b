"""What the trainer is made of: the schedules, the policy, the replay, the configuration."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.rl.config import FAST, ORIGINAL, preset
from drone_env.rl.policy import EpsilonGreedyPolicy, epsilon_greedy, linear, multiplicative
from drone_env.rl.replay_buffer import ReplayBuffer
from drone_env.rl.trainer import Trainer
from tests.unit.small_training import SMALL

# Policy


@pytest.mark.feature("L3")
def test_schedules() -> None:
    line = [linear(1.0, 0.05, 5000, step) for step in (0, 2500, 5000, 10**9)]
    assert line == [1.0, pytest.approx(0.525), pytest.approx(0.05), pytest.approx(0.05)]
    factors = [multiplicative(1.0, 0.05, 0.995, episode) for episode in (0, 1, 2, 10_000)]
    assert factors == [1, 0.995, pytest.approx(0.995**2), 0.05]
    with pytest.raises(InvalidValueError, match="at least 1 step"):
        EpsilonGreedyPolicy(decay_steps=0)
    for wrong in ({"epsilon_steps": 0}, {"epsilon_factor": 1.5}, {"epsilon_factor": 0.0}):
        with pytest.raises(InvalidValueError, match=next(iter(wrong))):
            replace(SMALL, **wrong)


@pytest.mark.feature("L3")
def test_epsilon_greedy_explores_as_often_as_it_says() -> None:
    q_values = np.tile(np.array([0, 0, 9, 0, 0], np.float32), (100_000, 1))
    assert (epsilon_greedy(q_values, 0.0, np.random.default_rng(0)) == 2).all()
    actions = epsilon_greedy(q_values, 0.5, np.random.default_rng(0))
    assert np.bincount(actions, minlength=5) / len(actions) == pytest.approx([0.1, 0.1, 0.6, 0.1, 0.1], abs=0.01)
    policy = EpsilonGreedyPolicy()
    assert policy == EpsilonGreedyPolicy(eps_start=1.0, eps_end=0.05, decay_steps=5000)
    assert [policy.epsilon(step) for step in (0, 2500, 5000)] == pytest.approx([1.0, 0.525, 0.05])
    for step in (0, 2500, 5000):
        chosen = policy.act(q_values[:20_000], step, np.random.default_rng(0))
        assert (chosen == 2).mean() == pytest.approx(1 - 0.8 * policy.epsilon(step), abs=0.02)
    with pytest.raises(InvalidValueError, match="probability"):
        EpsilonGreedyPolicy(eps_start=2)


# Replay


def test_the_replay_sums_rewards_up_to_the_end_of_an_episode() -> None:
    replay = ReplayBuffer(capacity=10, num_envs=2, height=1, width=1, telemetry_size=5)
    ends = {(0, 2), (1, 3)}
    for t in range(5):
        marks = np.array([t, 100 + t])
        replay.add(
            marks.reshape(2, 1, 1).astype(np.uint8),
            np.zeros((2, 5), np.float32),
            np.array([t % 5, 4 - t % 5]),
            marks.astype(float),
            np.array([(env, t) in ends for env in range(2)]),
        )
    seen = set()
    sampled = replay.sample(500, n_step=2, gamma=0.5, rng=np.random.default_rng(0))
    for k in range(500):
        mark = int(sampled.grids[k, 0, 0])
        env, t = divmod(mark, 100)
        seen.add((env, t))
        over = [(env, t + i) in ends for i in range(2)]
        expected = mark if over[0] else mark + 0.5 * (mark + 1)
        assert sampled.returns[k] == expected
        assert sampled.discounts[k] == (0 if any(over) else 0.25)
        assert sampled.actions[k] == (t % 5 if env == 0 else 4 - t % 5)
        if not any(over):
            assert sampled.next_grids[k, 0, 0] == mark + 2
    assert seen == {(env, t) for env in range(2) for t in range(3)}


def test_the_replay_forgets_the_oldest_row_first() -> None:
    replay = ReplayBuffer(capacity=7, num_envs=2, height=1, width=1, telemetry_size=5)
    assert not replay.can_sample(1)
    with pytest.raises(InvalidValueError, match="needed"):
        replay.sample(1, 1, 0.9, np.random.default_rng(0))
    for t in range(10):
        replay.add(
            np.full((2, 1, 1), t, np.uint8),
            np.zeros((2, 5), np.float32),
            np.zeros(2, int),
            np.zeros(2),
            np.zeros(2, bool),
        )
    assert replay.held == 3
    sampled = replay.sample(200, 1, 0.9, np.random.default_rng(0))
    assert set(sampled.grids.ravel().tolist()) == {7, 8}
    assert (sampled.next_grids == sampled.grids + 1).all()
    with pytest.raises(InvalidValueError, match="does not hold"):
        ReplayBuffer(3, 2, 1, 1, 5)


# Configuration


@pytest.mark.feature("L4", "L5")
def test_the_original_preset_is_the_originals() -> None:
    assert (ORIGINAL.gamma, ORIGINAL.batch_size, ORIGINAL.learning_rate, ORIGINAL.replay_size) == (
        0.99,
        64,
        1e-4,
        10_000,
    )
    assert (ORIGINAL.target_update, ORIGINAL.target_every) == ("episodes", 10)
    assert (ORIGINAL.checkpoint_episodes, ORIGINAL.checkpoint_seconds) == (50, 0)
    assert (ORIGINAL.epsilon_start, ORIGINAL.epsilon_end, ORIGINAL.epsilon_factor) == (1.0, 0.05, 0.995)
    assert ORIGINAL.exploration == "multiplicative"
    assert (ORIGINAL.double, ORIGINAL.advantage_learning, ORIGINAL.max_grad_norm) == (False, 0, 0)


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_both_presets(task: str) -> None:
    assert get_task(preset("fast", task).task).id == task
    assert preset("original", task) == replace(ORIGINAL, task=task)
    assert set(FAST) <= set(TASKS)
    assert preset("fast", task) == replace(FAST.get(task, FAST["hard_delivery"]), task=task)


@pytest.mark.parametrize("task", TASKS)
def test_few_episodes_are_flown_on_few_places(task: str) -> None:
    """So that each place flies many, one after the other, and chance has gone before the last."""
    usual = preset("fast", task)
    for episodes in (1, 15, 60, 200, 500, usual.episodes - 1):
        few = preset("fast", task, episodes)
        assert few.episodes == episodes
        assert few.num_envs == 1 or few.num_envs * 16 <= episodes < few.num_envs * 32
        assert few.learning_starts <= few.num_envs * get_task(task).max_steps
        assert few.epsilon_steps <= episodes * get_task(task).max_steps
    for episodes in (usual.episodes, usual.episodes + 1):
        assert preset("fast", task, episodes) == replace(usual, episodes=episodes)
    assert preset("original", task, 7) == replace(ORIGINAL, task=task, episodes=7)
    with pytest.raises(InvalidValueError, match="episodes must be above 0"):
        preset("fast", task, 0)


@pytest.mark.parametrize(
    "wrong",
    [{"episodes": 0}, {"gamma": 1.5}, {"num_envs": 0}, {"learning_rate": 0.0}, {"replay_size": 10}, {"seed": -1}],
)
def test_numbers_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError, match=next(iter(wrong))):
        replace(SMALL, **wrong)
    with pytest.raises(UnknownNameError):
        replace(SMALL, task="impossible")
    with pytest.raises(InvalidValueError, match="preset"):
        preset("slow", "easy")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there_is_said() -> None:
    with pytest.raises(InvalidValueError, match="CUDA"):
        Trainer(replace(SMALL, gpu=True))
