"""The trainer of the tour network: what it learns from, how, and that it goes on as if it had never stopped."""

import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import nn

from drone_env.core.seeds import split_of, split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.checkpoint import export_network
from drone_env.rl.lessons import Lessons, Teacher
from drone_env.rl.tour_config import SHARES, TourConfig, randomise, variant
from drone_env.rl.tour_trainer import TourTrainer
from tests.unit.small_training import SMALL_TOUR, assert_same, finished

EVERYTHING = replace(SMALL_TOUR, task="all", updates=9, validation_maps=1, states_per_map=4)


class Recorded(Teacher):
    """A teacher that tells what it was asked for."""

    asked: list[tuple[TaskConfig, list[int]]]

    def draw(self, seeds: npt.NDArray[np.int64]) -> Lessons:
        """As any other."""
        self.asked.append((self.task, seeds.tolist()))
        return super().draw(seeds)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[TaskConfig, list[int]]]:
    """The task and the maps of each chunk of lessons that is drawn."""
    monkeypatch.setattr(Recorded, "asked", [], raising=False)
    monkeypatch.setattr("drone_env.rl.tour_trainer.Teacher", Recorded)
    return Recorded.asked


# What it learns from


def test_lessons_are_drawn_on_train_maps_of_the_tasks_by_their_shares(
    asked: list[tuple[TaskConfig, list[int]]],
) -> None:
    config = replace(EVERYTHING, updates=12, maps_per_chunk=2, validation_every=12)
    trainer = finished(TourTrainer(config))
    seeds = [seed for _, maps in asked for seed in maps]
    assert len(set(seeds)) == 2 * len(asked) >= 24
    assert {split_of(seed) for seed in seeds} == {"train"}
    assert len({task.id for task, _ in asked}) > 4
    shares = config.lessons()
    assert 0 < sum(task in shares for task, _ in asked) < len(asked)
    assert sum(shares.values()) == pytest.approx(1)
    drawn = np.bincount([trainer._subject(chunk) for chunk in range(4000)], minlength=len(shares)) / 4000
    assert drawn == pytest.approx(list(shares.values()), abs=0.02)


def test_what_is_learned_and_what_is_validated() -> None:
    everything, one = TourConfig(), TourConfig(task="skyline_hard")
    assert [task.short_name for task in everything.tasks()] == ["easy", "medium", "hard", *list(SHARES)[3:]]
    assert "easy_delivery" not in {task.id for task in everything.lessons()}
    assert [*one.lessons().items()] == [(get_task("skyline_hard"), 1.0)]
    assert (everything.name, one.name) == ("tournet", "tournet_skyline_hard")
    own = variant("skyline_easy", 2, 4)
    assert (own.deliveries, own.pads, own.max_steps) == (2, 4, get_task("skyline_easy").max_steps)
    assert own in everything.lessons()
    assert own.id not in TASKS


def test_a_task_with_other_numbers() -> None:
    task, random = get_task("skyline_hard"), np.random.default_rng(0)
    drawn = [randomise(task, random) for _ in range(300)]
    alike = [other for other in drawn if other.width == task.width]
    for name, low, high in (
        ("battery_capacity", 16, 42), ("max_steps", 48, 352), ("charge_rate", 1, 10), ("pads", 1, 6),
    ):  # fmt: skip
        numbers = [getattr(other, name) for other in alike]
        assert low <= min(numbers) < getattr(task, name) < max(numbers) <= high
        assert numbers.count(getattr(task, name)) > 80
    large = [other for other in drawn if other.width > task.width]
    assert {(other.deliveries, other.width == other.height <= 48) for other in large} == {(4, True)}
    assert all(abs(other.buildings - task.buildings * (other.width / 16) ** 2) < 1 for other in large)
    # Where nothing charges and nothing is drawn along streets.
    hard = randomise(get_task("hard"), random)
    assert (hard.pads, hard.charge_rate, hard.width) == (0, 0, 18)


# How it learns


def test_the_step_size_rises_and_then_falls_along_half_a_cosine() -> None:
    config = replace(SMALL_TOUR, updates=100, warm_up=4, learning_rate=0.1, final_learning_rate=0.02)
    trainer, rates = TourTrainer(config), []
    for trainer.updates in range(101):
        rates.append(trainer.learning_rate)
    cosine = [0.06 + 0.04 * math.cos(math.pi * update / 100) for update in range(101)]
    assert rates == pytest.approx([rate * min(1, (u + 1) / 5) for u, rate in enumerate(cosine)])
    assert (rates[50], rates[100]) == (pytest.approx(0.06), pytest.approx(0.02))


def weights(network: nn.Module) -> list[torch.Tensor]:
    return [parameter.detach().clone() for parameter in network.parameters()]


def test_the_average_follows_the_weights_that_learn_and_is_what_is_kept() -> None:
    trainer = TourTrainer(replace(SMALL_TOUR, updates=40, average=0.6, validation_every=40))
    expected = weights(trainer.online)
    assert_same(weights(trainer.average), expected)
    for update, _ in enumerate(islice(trainer.train(), 25), start=1):
        kept = min(0.6, 1 - 1 / (update / 10 + 1))
        expected = [kept * a + (1 - kept) * b for a, b in zip(expected, weights(trainer.online), strict=True)]
        for found, wanted in zip(weights(trainer.average), expected, strict=True):
            assert torch.allclose(found, wanted, atol=1e-6)
    assert not all(map(torch.equal, weights(trainer.average), weights(trainer.online)))
    assert trainer.best_network() is None
    trainer.validate()
    best = trainer.best_network()
    assert best is not None
    assert_same(dict(best.state_dict()), dict(trainer.average.state_dict()))


def test_it_soon_flies_better_than_to_the_nearest_target() -> None:
    trainer = finished(TourTrainer(replace(
        SMALL_TOUR, updates=60, batch_size=64, warm_up=10, maps_per_chunk=4, states_per_map=32, window=12,
        learning_rate=2e-3, average=0.9, validation_every=60, validation_maps=50, log_every=10,
    )))  # fmt: skip
    maps = split_seeds("validation", 50)
    greedy = summarise(run_episodes(episodes_key("skyline_easy", "greedy", maps, "validation")))
    (share,) = trainer.shares.values()
    assert share > greedy["mean_score"] / greedy["mean_optimal_score"] + 0.1
    first, last = trainer.history[0], trainer.history[-1]
    assert last.regret < first.regret / 2
    assert last.completion < first.completion / 2


def test_a_validation_is_what_evaluation_says_of_the_exported_average(tmp_path: Path) -> None:
    trainer = TourTrainer(replace(SMALL_TOUR, validation_maps=20))
    with torch.no_grad():
        for parameter in trainer.online.parameters():
            parameter.neg_()
    trainer.validate()
    export_network(trainer.best_network(), tmp_path / "net.npz", trainer.metadata())
    maps = split_seeds("validation", 20)
    key = episodes_key("skyline_easy", f"tournet:{tmp_path / 'net.npz'}", maps, "validation")
    figures = summarise(run_episodes(key))
    assert trainer.shares == {"skyline_easy": pytest.approx(figures["mean_score"] / figures["mean_optimal_score"])}
    # Another training can start from it.
    other = TourTrainer(replace(SMALL_TOUR, initial=str(tmp_path / "net.npz"), seed=1))
    assert_same(weights(other.online), weights(trainer.average))


def test_the_lines_of_its_log() -> None:
    trainer = finished(TourTrainer(replace(SMALL_TOUR, updates=9)))
    history = trainer.history
    assert [line.update for line in history] == [2, 4, 6, 8, 9]
    assert [line.states for line in history] == [16 * line.update for line in history]
    assert [bool(np.isnan(line.validation)) for line in history] == [True, True, False, False, False]
    assert history[-1].validation == trainer.shares["skyline_easy"]
    assert 0 < history[0].cpu_seconds < history[-1].cpu_seconds
