"""Batches of samples, and the losses of the tour network on them: against slow loops and the formulas."""

import math

import numpy as np
import pytest
import torch

from drone_env.agents.tour_features import SHORT_TIME, SMALL_BATTERY, make_features
from drone_env.rl.samples import Samples
from drone_env.rl.tournet import TourBatch, distillation_losses, sample_batch


def fake_samples(counts: list[int], chunk: int, stops: int = 2) -> Samples:
    """States with so many options; the features of an option are its chunk, state and place."""
    features = make_features(len(counts), stops, sum(counts))
    features.tokens[:] = np.arange(len(counts))[:, None, None]
    features.present[:] = True
    features.begins[1:] = np.cumsum(counts)
    features.token[:] = np.arange(sum(counts)) % 3
    features.options[:, :3] = [(chunk, m, k) for m, count in enumerate(counts) for k in range(count)]
    return Samples(features, features.options[:, :3] @ np.array([1, 0.1, 0.01], np.float32))


def test_a_batch_holds_the_options_of_the_states_that_it_chose() -> None:
    window = [fake_samples(counts, chunk) for chunk, counts in enumerate(([2, 5, 3], [4, 2], [3, 3, 2, 6]))]
    window.append(fake_samples([2, 7], 3, stops=4))
    batch = sample_batch(window, 40, np.random.default_rng(1))
    tokens, present, edges, owner, token, options = (part.numpy() for part in batch.inputs)
    assert (len(tokens), edges.shape[1:3]) == (40, (5, 5))
    table = batch.table(batch.values, -1.0).numpy()
    chosen: list[tuple[int, int]] = []
    for m in range(40):
        mine = options[owner == m]
        (chunk,), (state,) = set(mine[:, 0].astype(int).tolist()), set(mine[:, 1].astype(int).tolist())
        features, values = window[chunk]
        some = slice(features.begins[state], features.begins[state + 1])
        size, count = features.tokens.shape[1], len(mine)
        assert np.array_equal(tokens[m, :size], features.tokens[state])
        assert present[m].tolist() == [True] * size + [False] * (5 - size)
        assert np.array_equal(mine, features.options[some])
        assert np.array_equal(token[owner == m], features.token[some])
        assert np.array_equal(table[m, :count], values[some])
        assert (table[m, count:] == -1).all()
        chosen.append((chunk, state))
    # Ten of each of four chunks, which need not be different ones.
    assert all(len({chunk for chunk, _ in chosen[i : i + 10]}) == 1 for i in range(0, 40, 10))
    assert len({chunk for chunk, _ in chosen}) > 1
    assert len(set(chosen)) > 5


def test_the_losses_are_those_of_the_formulas() -> None:
    table, step_costs, temperature = [[0.95, 0.94, 0.5], [0.85, 0.91]], [0.01, 0.5], 0.02
    features, _ = fake_samples([len(row) for row in table], 0)
    for m, cost in enumerate(step_costs):
        features.tokens[m, 0, [SMALL_BATTERY, SHORT_TIME]] = 100 * 0.6 * cost, 400 * 0.4 * cost
    batch = TourBatch(features, np.array([value for row in table for value in row], np.float32))
    preference, completion = torch.randn((2, 5), generator=torch.Generator().manual_seed(0))
    losses = distillation_losses(preference, completion, batch, temperature)
    entropies, regrets, errors, option = [], [], [], 0
    for row, step_cost in zip(table, step_costs, strict=True):
        given = range(option, option + len(row))
        # The logit of a choice counts the completion twice.
        logits = [float(preference[k]) - 2 * math.log1p(math.exp(-float(completion[k]))) for k in given]
        targets = [math.exp((value - max(row)) / min(temperature, step_cost)) for value in row]
        chosen = [math.exp(logit) / sum(map(math.exp, logits)) for logit in logits]
        entropies.append(-sum(p / sum(targets) * math.log(q) for p, q in zip(targets, chosen, strict=True)))
        regrets.append(sum(q * min(max(row) - value, 0.1) for q, value in zip(chosen, row, strict=True)))
        for k, value in zip(given, row, strict=True):
            errors.append(math.log1p(math.exp(-float(completion[k]) if value >= 0.8 else float(completion[k]))))
        option += len(row)
    assert [float(loss) for loss in losses] == pytest.approx(
        [np.mean(entropies), np.mean(regrets), np.mean(errors)], rel=1e-5
    )
