"""The DQN trainer: what it flies, learns and logs, and that a resumed run equals an uninterrupted one."""

import random
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.core.seeds import SPLITS
from drone_env.rl.common import Validation
from drone_env.rl.model import PathQNet
from drone_env.rl.run import load_checkpoint, save_checkpoint
from drone_env.rl.trainer import Trainer
from tests.same import assert_same
from tests.unit.small_training import SMALL, finished, parameters, shared


def flown_for(trainer: Trainer, steps: int) -> Trainer:
    for _ in range(steps):
        trainer.fly()
    return trainer


# What it flies


def test_the_replay_holds_what_was_flown_on_train_maps() -> None:
    trainer = Trainer(replace(SMALL, replay_size=8 * 70, gamma=0.9))
    assert trainer.batch.reward_profile == profile_for_discount(get_reward_profile(SMALL.reward_profile), 0.9)
    seeds: set[int] = set()
    for row in range(65):  # easy flights end after 60 steps
        grids, telemetry = trainer.batch.grids.copy(), trainer.batch.telemetry.copy()
        seeds.update(trainer.batch.seeds.tolist())
        trainer.fly()
        assert (trainer.replay.grids[row] == grids).all()
        assert (trainer.replay.telemetry[row] == telemetry).all()
        assert (trainer.replay.terminated[row] == trainer.batch.terminated).all()
        assert np.allclose(trainer.replay.rewards[row], 10 * trainer.batch.rewards)
    assert len(seeds) > SMALL.num_envs
    assert max(seeds) < SPLITS["train"].stop


def test_it_flies_by_the_online_network_with_exploration() -> None:
    greedy = Trainer(replace(SMALL, epsilon_start=0.0, epsilon_end=0.0))
    with torch.no_grad():
        for parameter in greedy.target.parameters():
            parameter += torch.randn_like(parameter)
    obs = greedy.batch.grids.copy(), greedy.batch.telemetry.copy()
    greedy.fly()
    assert greedy.replay.actions[0].tolist() == greedy.q_values(*obs, greedy.online).argmax(axis=1).tolist()
    explorer = flown_for(Trainer(replace(SMALL, epsilon_start=1.0, epsilon_end=1.0)), 10)
    assert set(explorer.replay.actions[:10].ravel().tolist()) == set(range(5))


@pytest.mark.parametrize(("exploration", "epsilon"), [("linear", 0.75), ("multiplicative", 0.995**10)])
def test_epsilon_and_learning_rate_decay(exploration: Any, epsilon: float) -> None:
    trainer = Trainer(replace(SMALL, exploration=exploration))
    trainer.steps, trainer.episodes = 250, 10
    assert trainer.epsilon == pytest.approx(epsilon)
    assert trainer.learning_rate == pytest.approx(0.75 * 5e-4 + 0.25 * 1e-5)


# What it learns


@pytest.mark.parametrize(("double", "advantage"), [(True, 0.0), (False, 0.0), (True, 0.7), (False, 0.7)])
def test_the_network_is_fitted_to_the_targets_of_the_papers(double: bool, advantage: float) -> None:
    """Transition by transition from the formulas, against the trainer's batch."""
    config = replace(SMALL, double=double, advantage_learning=advantage, gamma=0.9, target_update="episodes")
    trainer = flown_for(Trainer(config), 30)
    trainer.replay.terminated[:30, ::2] = True  # half of the transitions are ends
    with torch.no_grad():
        for parameter in trainer.target.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    sample = trainer.replay.sample(16, 0.9, np.random.default_rng(0))
    grids, telemetry, actions, rewards, discounts, next_grids, next_telemetry = sample
    trainer.rng = np.random.default_rng(0)

    def values(network: PathQNet, grids: Any, telemetry: Any, i: int) -> list[float]:
        return trainer.q_values(grids[i : i + 1], telemetry[i : i + 1], network)[0].tolist()

    errors = []
    for i in range(16):
        later = values(trainer.target, next_grids, next_telemetry, i)
        selector = values(trainer.online, next_grids, next_telemetry, i) if double else later
        now = values(trainer.target, grids, telemetry, i)
        target = float(rewards[i]) + float(discounts[i]) * later[selector.index(max(selector))]
        target -= advantage * (max(now) - now[actions[i]])
        errors.append(abs(target - values(trainer.online, grids, telemetry, i)[actions[i]]))
    assert sorted(set(discounts.tolist())) == [0, pytest.approx(0.9)]
    trainer.learn()
    costs = [error**2 / 2 if error < 1 else error - 0.5 for error in errors]
    assert trainer.losses == [pytest.approx(np.mean(costs), rel=1e-4)]


def test_an_update_clips_gradients_and_uses_the_current_learning_rate() -> None:
    def norm_and_step(max_grad_norm: float) -> tuple[float, float]:
        config = replace(SMALL, max_grad_norm=max_grad_norm, learning_rate=0.01, final_learning_rate=0.001)
        trainer = flown_for(Trainer(config), 10)
        trainer.episodes = SMALL.episodes // 2
        before = parameters(trainer.online)
        trainer.learn()
        step = max(float((a - b).abs().max()) for a, b in zip(before, parameters(trainer.online), strict=True))
        gradients = [parameter.grad.ravel() for parameter in trainer.online.parameters()]
        return float(torch.cat(gradients).norm()), step

    unbounded, step = norm_and_step(0)
    assert step == pytest.approx(0.0055, rel=0.01)  # Adam's first step, whatever the gradient
    assert unbounded > 0.01
    assert norm_and_step(0.01)[0] == pytest.approx(0.01, rel=1e-3)
    assert norm_and_step(2 * unbounded)[0] == pytest.approx(unbounded)


def test_a_soft_target_follows_a_little_at_every_update() -> None:
    trainer = flown_for(Trainer(replace(SMALL, tau=0.3)), 10)
    before = parameters(trainer.target)
    trainer.learn()
    expected = [0.7 * ours + 0.3 * theirs for ours, theirs in zip(before, parameters(trainer.online), strict=True)]
    assert not all(map(torch.equal, before, expected))
    assert all(torch.allclose(*pair, atol=1e-7) for pair in zip(parameters(trainer.target), expected, strict=True))


def test_a_target_by_episodes_is_copied_every_so_many() -> None:
    trainer = Trainer(replace(SMALL, episodes=16, target_update="episodes", target_every=8))
    first, copies = parameters(trainer.target), {}
    for _ in trainer.train():
        copies[trainer.episodes // 8] = all(map(torch.equal, parameters(trainer.target), first))
    assert copies == {0: True, 1: False, 2: False}
    assert_same(parameters(trainer.target), parameters(trainer.online))  # the last step ended with a copy


# What it logs


def test_its_figures_are_those_of_its_flights() -> None:
    trainer = Trainer(replace(SMALL, num_envs=1, episodes=6, log_every=1))
    reward, steps = 0.0, 0
    for lines in trainer.train():
        reward, steps = reward + trainer.batch.rewards[0], steps + 1
        for line in lines:
            score, deliveries = (trainer.batch.finals()[name][0] for name in ("score", "deliveries"))
            assert [line.reward, line.score] == pytest.approx([reward, score])
            assert (line.length, line.success, line.steps) == (steps, deliveries, trainer.steps)
            reward, steps = 0.0, 0
    assert [line.episode for line in trainer.history] == [1, 2, 3, 4, 5, 6]


def test_short_flights_are_not_told_before_the_long_ones_of_their_age() -> None:
    """Short flights went well: logged as they end, a run would seem to unlearn from its first line on."""
    config = replace(SMALL, num_envs=64, episodes=128, log_every=16, replay_size=4000, epsilon_end=1.0)
    trainer = finished(Trainer(replace(config, learning_starts=10**6)))  # all random, from first to last
    lines = [line for line in trainer.history if not np.isnan(line.score)]
    assert lines
    assert all(line.success < 0.7 and line.length > 35 for line in lines), lines


def test_the_best_network_is_kept() -> None:
    trainer = Trainer(SMALL)
    scores = iter([0.3, 0.5, 0.4, 0.5])
    trainer.validator.validate = lambda _: Validation(next(scores), 0.9)  # type: ignore[method-assign]
    kept = []
    for number in range(4):
        with torch.no_grad():
            for parameter in trainer.eval_network.parameters():
                parameter.fill_(number)
        trainer.validate()
        kept.append((trainer.best_score, next(iter(trainer.best.values())).ravel()[0].item()))
    assert kept == [(0.3, 0), (0.5, 1), (0.5, 1), (0.5, 3)]  # of equal ones the later


@pytest.mark.parametrize(("target_update", "eval_network"), [("soft", "target"), ("episodes", "online")])
def test_the_moving_average_is_what_is_judged(target_update: Any, eval_network: str) -> None:
    trainer = flown_for(Trainer(replace(SMALL, target_update=target_update)), 10)
    trainer.learn()
    assert not all(map(torch.equal, parameters(trainer.online), parameters(trainer.target)))
    trainer.validate()
    assert_same(trainer.best, dict(getattr(trainer, eval_network).state_dict()))


# Resuming


def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    config = replace(SMALL, episodes=16)
    uninterrupted = finished(Trainer(config))
    rng = random.Random(0)
    resumed, stops = Trainer(config), 0
    while resumed.episodes < config.episodes:
        for _ in islice(resumed.train(), rng.randint(1, 40)):
            pass
        stops += 1
        save_checkpoint(tmp_path / "run.pth", resumed.get_state())
        # Another seed reveals what the checkpoint lacks.
        resumed = Trainer(replace(config, seed=config.seed + stops))
        resumed.config = config
        resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    assert stops > 2
    assert_same(shared(uninterrupted.get_state()), shared(resumed.get_state()))
