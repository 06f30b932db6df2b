"""Training of the tour network from rewards: its trials, its losses, and that a resumed run continues bit for bit."""

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from drone_env.agents.tour_features import Features
from drone_env.agents.tour_plans import TourPlanner
from drone_env.core.tables import DELIVERIES_DONE
from drone_env.core.tasks import get_task
from drone_env.rl.common import clone_state
from drone_env.rl.run import load_checkpoint, save_checkpoint
from drone_env.rl.samples import SampleGenerator
from drone_env.rl.tour_rewards import COMPLETED, IMITATED, TEMPERATURES, Explorer, RewardTrainer, imitation_losses
from drone_env.rl.tournet import TourBatch
from tests.unit.small_training import SMALL_TOUR, assert_same, finished

SMALL = replace(SMALL_TOUR, kind="rewards", plans=3, maps_per_chunk=3)
EASY, MAPS, PLANS = get_task("skyline_easy"), np.arange(60), 4


def cheapest(features: Features) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """A network that prefers cheap paths."""
    return -features.numbers[:, 0] / np.float32(4), np.zeros(len(features.token), np.float32)


def test_the_best_plan_is_imitated_where_plans_differ() -> None:
    explorer = Explorer(EASY, cheapest, PLANS)
    rounds: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]] = []
    planner = TourPlanner(EASY, cheapest, PLANS, TEMPERATURES)
    flights = planner.fly(
        *explorer.start(MAPS), MAPS, lambda flying, grids, states, chosen: rounds.append((flying, chosen))
    )
    scores = flights.scores.reshape(len(MAPS), PLANS)
    differ = scores.max(axis=1) > scores.min(axis=1)
    assert 0 < differ.sum() < len(MAPS)
    best = (MAPS * PLANS + scores.argmax(axis=1))[differ]
    done = flights.states[:, DELIVERIES_DONE] == EASY.deliveries
    expected = [0, 0]
    for flying, chosen in rounds:
        for flight in flying[np.isin(flying, best) & (chosen >= 0)].tolist():
            expected[int(done[flight])] += 1

    trials = explorer.fly(MAPS, np.random.default_rng(0))
    imitated = trials.values >= IMITATED
    assert [(trials.values == IMITATED + completed).sum() for completed in (0, COMPLETED)] == expected
    assert 0 < (~imitated).sum() <= imitated.sum()
    features, values = explorer.samples(trials)
    assert (trials.chosen < np.diff(features.begins)).all()
    assert np.array_equal(values[features.begins[:-1] + trials.chosen], trials.values)
    assert np.isfinite(values).sum() == len(trials.chosen)


def test_only_what_was_tried_is_learned_from() -> None:
    by_state = np.zeros((3, 1)), np.ones((3, 1), np.bool_), np.zeros((3, 1, 1)), np.array([0, 2, 5, 6])
    features = Features(*by_state, np.zeros(6, np.int64), np.zeros((6, 1)), np.zeros((6, 3)))
    values = np.array([np.nan, 3, 1, np.nan, np.nan, 0], np.float32)
    preference = torch.tensor([1.0, 2.0, 0.0, 0.0, 5.0, 0.0], requires_grad=True)
    completion = torch.tensor([9.0, 1.0, -1.0, 9.0, 9.0, 2.0])
    choice, regret, completed = imitation_losses(preference, completion, TourBatch(features, values))
    logits = preference.detach() + 2 * torch.nn.functional.logsigmoid(completion)
    assert choice.item() == pytest.approx((torch.logsumexp(logits[:2], 0) - logits[1]).item())
    assert regret.isnan()
    costs = [np.log1p(np.exp(-1.0)), np.log1p(np.exp(1.0)), np.log1p(np.exp(2.0))]
    assert completed.item() == pytest.approx(np.mean(costs))
    choice.backward()
    assert preference.grad is not None
    assert preference.grad[2:].abs().max() == 0


def test_no_exact_value_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SampleGenerator, "__init__", lambda *_: pytest.fail("a label was generated"))
    trainer = RewardTrainer(SMALL)
    before = clone_state(trainer.online)
    list(islice(trainer.train(), 4))
    assert any(not torch.equal(weights, before[name]) for name, weights in trainer.online.state_dict().items())
    assert (trainer.metadata()["kind"], SMALL.name) == ("rewards", "tournet_rewards_skyline_easy")


def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    def state_of(trainer: RewardTrainer) -> dict[str, Any]:
        state = trainer.get_state()
        for line in (state, *state["history"]):
            del line["cpu_seconds"]
        return state

    config = replace(SMALL, updates=8)
    stopped = RewardTrainer(config)
    list(islice(stopped.train(), 5))
    save_checkpoint(tmp_path / "run.pth", stopped.get_state())
    resumed = RewardTrainer(replace(config, seed=9))
    resumed.config = config
    resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    assert_same(state_of(finished(RewardTrainer(config))), state_of(finished(resumed)))
