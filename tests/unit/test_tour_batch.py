"""Batches of lessons, and the losses of the tour network on them: as slow loops and the formulas say."""

import math

import numpy as np
import pytest
import torch

from drone_env.agents.tour_view import SHORT_TIME, SMALL_BATTERY, make_view
from drone_env.rl.lessons import Lessons
from drone_env.rl.tour_batch import Batch, losses_of, sample


def fake_lessons(counts: list[int], of: int, stops: int = 2) -> Lessons:
    """States with so many options, each of which tells by its features of which lessons, state and place it is."""
    view = make_view(len(counts), stops, sum(counts))
    view.tokens[:] = np.arange(len(counts))[:, None, None]
    view.present[:] = True
    view.begins[1:] = np.cumsum(counts)
    view.token[:] = np.arange(sum(counts)) % 3
    view.features[:, :3] = [(of, m, k) for m, count in enumerate(counts) for k in range(count)]
    return Lessons(view, view.features[:, :3] @ np.array([1, 0.1, 0.01], np.float32))


def test_a_batch_holds_the_options_of_the_states_that_it_chose() -> None:
    window = [fake_lessons(counts, of) for of, counts in enumerate(([2, 5, 3], [4, 2], [3, 3, 2, 6]))]
    window.append(fake_lessons([2, 7], 3, stops=4))
    batch = sample(window, 40, np.random.default_rng(1))
    tokens, present, edges, owner, token, features = (part.numpy() for part in batch.inputs)
    assert len(tokens) == 40
    table = batch.table(batch.values, -1.0).numpy()
    chosen: list[tuple[int, int]] = []
    for m in range(40):
        mine = features[owner == m]
        (of,), (state,) = set(mine[:, 0].astype(int).tolist()), set(mine[:, 1].astype(int).tolist())
        view, values = window[of]
        some = slice(view.begins[state], view.begins[state + 1])
        there = view.tokens.shape[1]
        assert np.array_equal(tokens[m, :there], view.tokens[state])
        assert present[m].tolist() == [True] * there + [False] * (5 - there)
        assert edges[m].shape[:2] == (5, 5)
        assert np.array_equal(mine, view.features[some])
        assert np.array_equal(token[owner == m], view.token[some])
        count = len(mine)
        assert np.array_equal(table[m, :count], values[some])
        assert (table[m, count:] == -1).all()
        chosen.append((of, state))
    # Ten of each of four lessons, which need not be different ones.
    assert all(len({of for of, _ in chosen[i : i + 10]}) == 1 for i in range(0, 40, 10))
    assert len({of for of, _ in chosen}) > 1
    assert len(set(chosen)) > 5


def batch_of(values: list[list[float]], step_costs: list[float]) -> Batch:
    """A batch of states whose options are worth so much, in their order, and what a step costs in each, in score."""
    lessons = fake_lessons([len(row) for row in values], 0)
    for m, cost in enumerate(step_costs):
        lessons.view.tokens[m, 0, [SMALL_BATTERY, SHORT_TIME]] = 100 * 0.6 * cost, 400 * 0.4 * cost
    return Batch(lessons.view, np.array([value for row in values for value in row], np.float32))


def test_the_losses_are_those_of_the_formulas() -> None:
    values, step_costs, temperature = [[0.95, 0.94, 0.5], [0.85, 0.91]], [0.01, 0.5], 0.02
    batch = batch_of(values, step_costs)
    rng = torch.Generator().manual_seed(0)
    preference, completion = torch.randn((2, 5), generator=rng, dtype=torch.float32)
    choice, regret, completions = losses_of(preference, completion, batch, temperature)
    entropies, regrets, errors, option = [], [], [], 0
    for row, step_cost in zip(values, step_costs, strict=True):
        given = range(option, option + len(row))
        # A choice needs an option that is liked and that the mission can be completed after: that counts twice.
        likes = [float(preference[k]) - 2 * math.log1p(math.exp(-float(completion[k]))) for k in given]
        wants = [math.exp((value - max(row)) / min(temperature, step_cost)) for value in row]
        chosen = [math.exp(like) / sum(map(math.exp, likes)) for like in likes]
        wanted = [want / sum(wants) for want in wants]
        entropies.append(-sum(p * math.log(q) for p, q in zip(wanted, chosen, strict=True)))
        regrets.append(sum(q * min(max(row) - value, 0.1) for q, value in zip(chosen, row, strict=True)))
        errors += [
            math.log1p(math.exp(-float(completion[k]) if value >= 0.8 else float(completion[k])))
            for k, value in zip(given, row, strict=True)
        ]
        option += len(row)
    assert float(choice) == pytest.approx(np.mean(entropies), rel=1e-5)
    assert float(regret) == pytest.approx(np.mean(regrets), rel=1e-5)
    assert float(completions) == pytest.approx(np.mean(errors), rel=1e-5)


def test_the_wanted_choice_is_where_the_cross_entropy_is_least() -> None:
    values, temperature = [[0.95, 0.94, 0.93]], 0.01
    batch = batch_of(values, [1.0])
    completion = torch.full((3,), 50.0)  # certain: it takes nothing from any choice
    preference = (torch.tensor(values[0]) / temperature).requires_grad_()
    choice, _, _ = losses_of(preference, completion, batch, temperature)
    choice.backward()
    assert preference.grad is not None
    assert preference.grad.abs().max() < 1e-4
    wanted = np.exp([0.0, -1.0, -2.0]) / np.exp([0.0, -1.0, -2.0]).sum()
    assert choice.item() == pytest.approx(-(wanted * np.log(wanted)).sum(), rel=1e-4)
    other, _, _ = losses_of(preference + torch.tensor([0, 1, 0]), completion, batch, temperature)
    assert other.item() > choice.item()
