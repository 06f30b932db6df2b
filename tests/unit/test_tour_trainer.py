"""The trainer of the tour network: its samples, its batches and losses, its updates and its validation."""

import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from drone_env.agents.tour_features import SHORT_TIME, make_features
from drone_env.agents.weights_file import write_weights
from drone_env.core.seeds import SPLITS, split_seeds
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.config import randomise
from drone_env.rl.samples import SampleGenerator, Samples
from drone_env.rl.tournet import TourBatch, TourTrainer, distillation_losses, sample_batch
from tests.same import assert_same
from tests.unit.small_training import SMALL_TOUR, finished, parameters


def test_samples_come_from_train_maps_of_the_tasks_by_their_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    chunks: list[tuple[TaskConfig, list[int]]] = []

    class Recorded(SampleGenerator):
        def generate(self, seeds: npt.NDArray[np.int64]) -> Samples:
            chunks.append((self.task, seeds.tolist()))
            return super().generate(seeds)

    monkeypatch.setattr("drone_env.rl.tournet.SampleGenerator", Recorded)
    config = replace(SMALL_TOUR, task="all", updates=9, states_per_map=4, maps_per_chunk=2, validation_every=9)
    trainer = TourTrainer(config)
    list(islice(trainer.train(), 8))  # without the validation, which flies all tasks
    seeds = [seed for _, maps in chunks for seed in maps]
    assert len(set(seeds)) == 2 * len(chunks) >= 16
    assert max(seeds) < SPLITS["train"].stop
    assert len({task.id for task, _ in chunks}) > 3
    shares = config.sampled_tasks()
    assert 0 < sum(task in shares for task, _ in chunks) < len(chunks)
    assert sum(shares.values()) == pytest.approx(1)
    counts = np.bincount([trainer._task_of(chunk) for chunk in range(2000)], minlength=len(shares)) / 2000
    assert counts == pytest.approx(list(shares.values()), abs=0.03)


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
    trainer = TourTrainer(replace(SMALL_TOUR, updates=20, average=0.3, validation_every=20))
    expected = parameters(trainer.online)
    for update, _ in enumerate(islice(trainer.train(), 8), start=1):
        kept = min(0.3, 1 - 1 / (update / 10 + 1))
        expected = [kept * a + (1 - kept) * b for a, b in zip(expected, parameters(trainer.online), strict=True)]
        assert all(torch.allclose(*pair, atol=1e-6) for pair in zip(parameters(trainer.average), expected, strict=True))
    assert not all(map(torch.equal, parameters(trainer.average), parameters(trainer.online)))
    assert not trainer.best
    trainer.validate()
    assert_same(trainer.best, dict(trainer.average.state_dict()))


def test_it_soon_flies_better_than_to_the_nearest_target() -> None:
    trainer = finished(TourTrainer(replace(
        SMALL_TOUR, updates=60, batch_size=64, warm_up=10, maps_per_chunk=4, states_per_map=32, window=12,
        learning_rate=2e-3, average=0.9, validation_every=60, validation_maps=30, log_every=10,
    )))  # fmt: skip
    maps = split_seeds("validation", 30)
    greedy = summarise(run_episodes(episodes_key("skyline_easy", "greedy", maps, "validation")))
    (ratio,) = trainer.ratios.values()
    assert ratio > greedy["mean_score"] / greedy["mean_optimal_score"] + 0.1
    first, last = trainer.history[0], trainer.history[-1]
    assert last.regret < first.regret / 2
    assert last.completion < 0.6 * first.completion


def test_a_validation_is_what_evaluation_says_of_the_exported_average(tmp_path: Path) -> None:
    trainer, file = TourTrainer(replace(SMALL_TOUR, validation_maps=20)), tmp_path / "net.safetensors"
    with torch.no_grad():
        for parameter in trainer.online.parameters():
            parameter.neg_()
    trainer.validate()
    write_weights(file, {name: tensor.numpy() for name, tensor in trainer.best.items()}, trainer.metadata())
    key = episodes_key("skyline_easy", f"tournet:{file}", split_seeds("validation", 20), "validation")
    figures = summarise(run_episodes(key))
    assert trainer.ratios == {"skyline_easy": pytest.approx(figures["mean_score"] / figures["mean_optimal_score"])}


def fake_samples(counts: list[int], chunk: int, stops: int = 2) -> Samples:
    """States with so many options; the features of an option are its chunk, state and place."""
    features = make_features(len(counts), stops, sum(counts))
    features.tokens[:] = np.arange(len(counts))[:, None, None]
    features.present[:] = True
    features.begins[1:] = np.cumsum(counts)
    features.token[:] = np.arange(sum(counts)) % 3
    features.options[:, :3] = [(chunk, m, k) for m, count in enumerate(counts) for k in range(count)]
    values = features.options[:, :3] @ np.array([1, 0.1, 0.01], np.float32)
    return Samples(features, values, np.arange(sum(counts), dtype=np.int8))


def test_a_batch_holds_the_options_of_the_states_that_it_chose() -> None:
    window = [fake_samples(counts, chunk) for chunk, counts in enumerate(([2, 5, 3], [4, 2], [3, 3, 2, 6]))]
    window.append(fake_samples([2, 7], 3, stops=4))
    batch = sample_batch(window, 40, np.random.default_rng(1))
    tokens, present, edges, owner, token, options = (part.numpy() for part in batch.inputs)
    assert (len(tokens), edges.shape[1:3]) == (40, (5, 5))
    table, of_parcels = (batch.table(numbers, -1.0).numpy() for numbers in (batch.values, batch.parcels))
    chosen: list[tuple[int, int]] = []
    for m in range(40):
        mine = options[owner == m]
        (chunk,), (state,) = set(mine[:, 0].astype(int).tolist()), set(mine[:, 1].astype(int).tolist())
        features, values, parcels = window[chunk]
        some = slice(features.begins[state], features.begins[state + 1])
        size, count = features.tokens.shape[1], len(mine)
        assert np.array_equal(tokens[m, :size], features.tokens[state])
        assert present[m].tolist() == [True] * size + [False] * (5 - size)
        assert np.array_equal(mine, features.options[some])
        assert np.array_equal(token[owner == m], features.token[some])
        assert np.array_equal(table[m, :count], values[some])
        assert np.array_equal(of_parcels[m, :count], parcels[some])
        assert (table[m, count:] == -1).all()
        chosen.append((chunk, state))
    # Ten of each of four chunks, which need not be different ones.
    assert all(len({chunk for chunk, _ in chosen[i : i + 10]}) == 1 for i in range(0, 40, 10))
    assert len({chunk for chunk, _ in chosen}) > 1
    assert len(set(chosen)) > 5


def test_the_losses_are_those_of_the_formulas() -> None:
    table, parcels = [[0.95, 0.94, 0.5], [0.85, 0.91]], [[3, 3, 2], [2, 3]]
    step_costs, temperature = [0.01, 0.5], 0.02
    features, *_ = fake_samples([len(row) for row in table], 0)
    features.tokens[:, 0, SHORT_TIME] = 400 * np.array(step_costs)
    values, delivered = (np.array([x for row in rows for x in row]) for rows in (table, parcels))
    batch = TourBatch(features, values.astype(np.float32), delivered.astype(np.int8))
    preference, completion = torch.randn((2, 5), generator=torch.Generator().manual_seed(0))
    losses = distillation_losses(preference, completion, batch, temperature)
    entropies, regrets, errors, option = [], [], [], 0
    for row, reached, step_cost in zip(table, parcels, step_costs, strict=True):
        given = range(option, option + len(row))
        # The logit of a choice counts the completion twice.
        logits = [float(preference[k]) - 2 * math.log1p(math.exp(-float(completion[k]))) for k in given]
        targets = [math.exp((value - max(row)) / min(temperature, step_cost)) for value in row]
        chosen = [math.exp(logit) / sum(map(math.exp, logits)) for logit in logits]
        entropies.append(-sum(p / sum(targets) * math.log(q) for p, q in zip(targets, chosen, strict=True)))
        regrets.append(sum(q * min(max(row) - value, 0.1) for q, value in zip(chosen, row, strict=True)))
        for k, number in zip(given, reached, strict=True):
            errors.append(math.log1p(math.exp(-float(completion[k]) if number == 3 else float(completion[k]))))
        option += len(row)
    assert [float(loss) for loss in losses] == pytest.approx(
        [np.mean(entropies), np.mean(regrets), np.mean(errors)], rel=1e-5
    )
