"""The trainer of the tour network: its samples, its updates, its validation and its log."""

import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from drone_env.agents.weights_file import write_weights
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.samples import SampleGenerator, Samples
from drone_env.rl.tour_config import randomise
from drone_env.rl.tournet import TourTrainer
from tests.same import assert_same
from tests.unit.small_training import SMALL_TOUR, finished, parameters


def test_samples_come_from_train_maps_of_the_tasks_by_their_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    chunks: list[tuple[TaskConfig, list[int]]] = []

    class Recorded(SampleGenerator):
        def generate(self, seeds: npt.NDArray[np.int64]) -> Samples:
            chunks.append((self.task, seeds.tolist()))
            return super().generate(seeds)

    monkeypatch.setattr("drone_env.rl.tournet.SampleGenerator", Recorded)
    config = replace(SMALL_TOUR, task="all", updates=12, validation_maps=1, states_per_map=4, maps_per_chunk=2,
                     validation_every=12)  # fmt: skip
    trainer = finished(TourTrainer(config))
    seeds = [seed for _, maps in chunks for seed in maps]
    assert len(set(seeds)) == 2 * len(chunks) >= 24
    assert max(seeds) < SPLITS["train"].stop
    assert len({task.id for task, _ in chunks}) > 4
    shares = config.sampled_tasks()
    assert 0 < sum(task in shares for task, _ in chunks) < len(chunks)
    assert sum(shares.values()) == pytest.approx(1)
    counts = np.bincount([trainer._task_of(chunk) for chunk in range(4000)], minlength=len(shares)) / 4000
    assert counts == pytest.approx(list(shares.values()), abs=0.02)


def test_a_task_with_other_numbers() -> None:
    task, rng = get_task("skyline_hard"), np.random.default_rng(0)
    changed = [randomise(task, rng) for _ in range(300)]
    same_size = [other for other in changed if other.width == task.width]
    for name in ("battery_capacity", "max_steps", "charge_rate", "pads"):
        numbers = [getattr(other, name) for other in same_size]
        assert min(numbers) < getattr(task, name) < max(numbers)
    large = [other for other in changed if other.width > task.width]
    assert {(other.deliveries, other.width == other.height <= 48) for other in large} == {(4, True)}
    assert all(abs(other.buildings - task.buildings * (other.width / 16) ** 2) < 1 for other in large)
    hard = randomise(get_task("hard"), rng)  # no pads, no streets
    assert (hard.pads, hard.charge_rate, hard.width) == (0, 0, 18)


def test_the_learning_rate_warms_up_and_decays_along_half_a_cosine() -> None:
    config = replace(SMALL_TOUR, updates=100, warm_up=4, learning_rate=0.1, final_learning_rate=0.02)
    trainer, rates = TourTrainer(config), []
    for trainer.updates in range(101):
        rates.append(trainer.learning_rate)
    cosine = [0.06 + 0.04 * math.cos(math.pi * update / 100) for update in range(101)]
    assert rates == pytest.approx([rate * min(1, (u + 1) / 5) for u, rate in enumerate(cosine)])


def test_the_average_follows_the_weights_that_learn_and_is_what_is_kept() -> None:
    trainer = TourTrainer(replace(SMALL_TOUR, updates=40, average=0.6, validation_every=40))
    expected = parameters(trainer.online)
    for update, _ in enumerate(islice(trainer.train(), 25), start=1):
        kept = min(0.6, 1 - 1 / (update / 10 + 1))
        expected = [kept * a + (1 - kept) * b for a, b in zip(expected, parameters(trainer.online), strict=True)]
        assert all(torch.allclose(*pair, atol=1e-6) for pair in zip(parameters(trainer.average), expected, strict=True))
    assert not all(map(torch.equal, parameters(trainer.average), parameters(trainer.online)))
    assert trainer.best_network() is None
    trainer.validate()
    best = trainer.best_network()
    assert best is not None
    assert_same(parameters(best), parameters(trainer.average))


def test_it_soon_flies_better_than_to_the_nearest_target() -> None:
    trainer = finished(TourTrainer(replace(
        SMALL_TOUR, updates=60, batch_size=64, warm_up=10, maps_per_chunk=4, states_per_map=32, window=12,
        learning_rate=2e-3, average=0.9, validation_every=60, validation_maps=50, log_every=10,
    )))  # fmt: skip
    maps = split_seeds("validation", 50)
    greedy = summarise(run_episodes(episodes_key("skyline_easy", "greedy", maps, "validation")))
    (ratio,) = trainer.ratios.values()
    assert ratio > greedy["mean_score"] / greedy["mean_optimal_score"] + 0.1
    first, last = trainer.history[0], trainer.history[-1]
    assert last.regret < first.regret / 2
    assert last.completion < first.completion / 2


def test_a_validation_is_what_evaluation_says_of_the_exported_average(tmp_path: Path) -> None:
    trainer, file = TourTrainer(replace(SMALL_TOUR, validation_maps=20)), tmp_path / "net.safetensors"
    with torch.no_grad():
        for parameter in trainer.online.parameters():
            parameter.neg_()
    trainer.validate()
    write_weights(file, {name: tensor.numpy() for name, tensor in trainer.validated.items()}, trainer.metadata())
    key = episodes_key("skyline_easy", f"tournet:{file}", split_seeds("validation", 20), "validation")
    figures = summarise(run_episodes(key))
    assert trainer.ratios == {"skyline_easy": pytest.approx(figures["mean_score"] / figures["mean_optimal_score"])}
    # Another training can start from it.
    other = TourTrainer(replace(SMALL_TOUR, initial=str(file), seed=1))
    assert_same(parameters(other.online), parameters(trainer.average))
