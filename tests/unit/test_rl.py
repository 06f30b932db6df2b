"""The parts of DQN: schedules, policy, replay buffer, settings."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.rl.config import FAST, ORIGINAL, preset
from drone_env.rl.policy import EpsilonGreedyPolicy, epsilon_greedy, linear, multiplicative
from drone_env.rl.trainer import ReplayBuffer, Trainer
from tests.unit.small_training import SMALL, SMALL_TOUR


@pytest.mark.feature("L3")
def test_schedules() -> None:
    line = [linear(1.0, 0.05, 5000, step) for step in (0, 2500, 5000, 10**9)]
    assert line == [1.0, pytest.approx(0.525), 0.05, 0.05]
    factors = [multiplicative(1.0, 0.05, 0.995, episode) for episode in (0, 1, 2, 10_000)]
    assert factors == [1, 0.995, pytest.approx(0.995**2), 0.05]


@pytest.mark.feature("L3")
def test_epsilon_greedy_explores_with_probability_epsilon() -> None:
    q_values = np.tile(np.array([0, 0, 9, 0, 0], np.float32), (100_000, 1))
    assert (epsilon_greedy(q_values, 0.0, np.random.default_rng(0)) == 2).all()
    actions = epsilon_greedy(q_values, 0.5, np.random.default_rng(0))
    assert np.bincount(actions, minlength=5) / len(actions) == pytest.approx([0.1, 0.1, 0.6, 0.1, 0.1], abs=0.01)
    policy = EpsilonGreedyPolicy()
    assert policy == EpsilonGreedyPolicy(eps_start=1.0, eps_end=0.05, decay_steps=5000)
    for step, epsilon in ((0, 1.0), (2500, 0.525), (5000, 0.05)):
        assert policy.epsilon(step) == pytest.approx(epsilon)
        chosen = policy.act(q_values[:20_000], step, np.random.default_rng(0))
        assert (chosen == 2).mean() == pytest.approx(1 - 0.8 * epsilon, abs=0.02)
    with pytest.raises(InvalidValueError, match="eps_start should be"):
        EpsilonGreedyPolicy(eps_start=2.0)


def filled(capacity: int, steps: int, ends: set[tuple[int, int]]) -> ReplayBuffer:
    """A buffer of two environments; grids and rewards are 100 * environment + step, actions step % 5."""
    replay = ReplayBuffer(capacity, num_envs=2, height=1, width=1, telemetry_size=5)
    for t in range(steps):
        marks = np.array([t, 100 + t])
        terminated = np.array([(env, t) in ends for env in range(2)])
        grids = marks.reshape(2, 1, 1).astype(np.uint8)
        replay.add(grids, np.zeros((2, 5), np.float32), np.full(2, t % 5), marks.astype(float), terminated)
    return replay


def test_the_replay_bootstraps_up_to_the_end_of_an_episode() -> None:
    ends = {(0, 2), (1, 3)}
    sampled = filled(10, 5, ends).sample(500, gamma=0.5, rng=np.random.default_rng(0))
    grids, _, actions, rewards, discounts, next_grids, _ = sampled
    seen: set[tuple[int, int]] = set()
    for k in range(500):
        mark = int(grids[k, 0, 0])
        env, t = divmod(mark, 100)
        seen.add((env, t))
        assert rewards[k] == mark
        assert discounts[k] == (0 if (env, t) in ends else 0.5)
        assert actions[k] == t % 5
        assert next_grids[k, 0, 0] == mark + 1
    assert seen == {(env, t) for env in range(2) for t in range(4)}


def test_the_replay_forgets_the_oldest_row_first() -> None:
    replay = filled(7, 10, set())
    assert replay.stored == 3
    grids, *_, next_grids, _ = replay.sample(200, 0.9, np.random.default_rng(0))
    assert set(grids.ravel().tolist()) == {7, 8, 107, 108}
    assert (next_grids == grids + 1).all()


@pytest.mark.feature("L4", "L5")
def test_the_original_preset_is_the_originals() -> None:
    assert replace(
        ORIGINAL, gamma=0.99, batch_size=64, learning_rate=1e-4, replay_size=10_000, target_update="episodes",
        target_every=10, checkpoint_episodes=50, checkpoint_seconds=0, epsilon_start=1.0, epsilon_end=0.05,
        epsilon_factor=0.995, exploration="multiplicative", double=False, advantage_learning=0, max_grad_norm=0,
    ) == ORIGINAL  # fmt: skip


@pytest.mark.parametrize("task", TASKS)
def test_presets_fit_the_task_and_the_number_of_episodes(task: str) -> None:
    """With fewer episodes, `fast` flies fewer in parallel, so that exploration ends before the last."""
    usual = preset("fast", task)
    assert get_task(usual.task).id == task
    assert usual == replace(FAST.get(task, FAST["hard_delivery"]), task=task)
    for episodes in (1, 15, 60, 200, 500, usual.episodes - 1):
        few = preset("fast", task, episodes)
        assert few.episodes == episodes
        assert few.num_envs == 1 or few.num_envs * 16 <= episodes < few.num_envs * 32
        assert few.learning_starts <= few.num_envs * get_task(task).max_steps
        assert few.epsilon_steps <= episodes * get_task(task).max_steps
    assert preset("fast", task, usual.episodes + 1) == replace(usual, episodes=usual.episodes + 1)
    assert preset("original", task, 7) == replace(ORIGINAL, task=task, episodes=7)


@pytest.mark.parametrize(
    ("config", "wrong", "message"),
    [
        (SMALL, {"episodes": 0}, "episodes should be greater than 0, got 0"),
        (SMALL, {"exploration": "fast"}, "exploration should be 'linear' or 'multiplicative', got 'fast'"),
        (SMALL, {"replay_size": 10}, "replay_size 10 does not hold 3 steps of 8 episodes"),
        (SMALL, {"task": "impossible"}, "unknown task 'impossible'"),
        (SMALL_TOUR, {"task": "easy"}, "nothing to choose on 'easy_delivery': one parcel, one path"),
    ],
)
def test_settings_out_of_range_are_rejected(config: Any, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        replace(config, **wrong)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_rejected() -> None:
    with pytest.raises(InvalidValueError, match="CUDA"):
        Trainer(replace(SMALL, gpu=True))
