"""A tour network that learns from the scores of its own plans: what it keeps of them, what it loses, how it goes on."""

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from drone_env.agents.tour_plans import TourPlanner
from drone_env.agents.tour_view import View
from drone_env.core.tables import DELIVERIES_DONE
from drone_env.core.tasks import get_task
from drone_env.rl.checkpoint import load_checkpoint, save_checkpoint
from drone_env.rl.lessons import Teacher
from drone_env.rl.tour_batch import Batch
from drone_env.rl.tour_rewards import COMPLETED, IMITATED, TEMPERATURES, Explorer, RewardTrainer, losses_of_tries
from tests.unit.small_training import SMALL_TOUR, assert_same, finished

SMALL = replace(SMALL_TOUR, kind="rewards", plans=3, maps_per_chunk=3)
EASY, MAPS, PLANS = get_task("skyline_easy"), np.arange(60), 4


def cheapest(view: View) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """A network that likes ways the better the less they drain."""
    return -view.numbers[:, 0] / np.float32(4), np.zeros(len(view.token), np.float32)


def test_the_best_plan_is_imitated_where_plans_differ() -> None:
    explorer = Explorer(EASY, cheapest, PLANS)
    rounds: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]] = []
    planner = TourPlanner(EASY, cheapest, PLANS, TEMPERATURES)
    flights = planner.fly(
        *explorer.begin(MAPS), MAPS, lambda flying, grids, states, chosen: rounds.append((flying, chosen))
    )
    scores = flights.scores.reshape(len(MAPS), PLANS)
    differ = scores.max(axis=1) > scores.min(axis=1)
    assert 0 < differ.sum() < len(MAPS)
    best = (MAPS * PLANS + scores.argmax(axis=1))[differ]
    alike = (MAPS * PLANS)[~differ]
    assert sum((np.isin(flying, alike) & (chosen >= 0)).sum() for flying, chosen in rounds) > 0
    done = flights.states[:, DELIVERIES_DONE] == EASY.deliveries
    expected: dict[bool, int] = {True: 0, False: 0}
    for flying, chosen in rounds:
        for flight in flying[np.isin(flying, best) & (chosen >= 0)].tolist():
            expected[bool(done[flight])] += 1

    tried = explorer.fly(MAPS, np.random.default_rng(0))
    imitated = tried.values >= IMITATED
    assert (tried.values == IMITATED + COMPLETED).sum() == expected[True]
    assert (tried.values == IMITATED).sum() == expected[False]
    assert 0 < (~imitated).sum() <= imitated.sum()

    lessons = explorer.lessons(tried)
    begins = lessons.view.begins
    assert (tried.chosen < np.diff(begins)).all()
    assert np.array_equal(lessons.values[begins[:-1] + tried.chosen], tried.values)
    assert np.isfinite(lessons.values).sum() == len(tried.chosen)


def test_only_what_was_tried_is_learned_from() -> None:
    view = View(*(np.zeros(0) for _ in range(3)), np.array([0, 2, 5, 6]), *(np.zeros(6, np.int64) for _ in range(3)))
    values = np.array([np.nan, 3, 1, np.nan, np.nan, 0], np.float32)
    view = view._replace(
        tokens=np.zeros((3, 1)), present=np.ones((3, 1), np.bool_), edges=np.zeros((3, 1, 1)), features=np.zeros((6, 1))
    )
    preference = torch.tensor([1.0, 2.0, 0.0, 0.0, 5.0, 0.0], requires_grad=True)
    completion = torch.tensor([9.0, 1.0, -1.0, 9.0, 9.0, 2.0])
    choice, regret, completed = losses_of_tries(preference, completion, Batch(view, values))
    logits = preference.detach() + 2 * torch.nn.functional.logsigmoid(completion)
    assert choice.item() == pytest.approx((torch.logsumexp(logits[:2], 0) - logits[1]).item())
    assert regret.isnan()
    costs = [np.log1p(np.exp(-1.0)), np.log1p(np.exp(1.0)), np.log1p(np.exp(2.0))]
    assert completed.item() == pytest.approx(np.mean(costs))
    choice.backward()
    assert preference.grad is not None
    assert preference.grad[2:].abs().max() == 0


def test_no_exact_value_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a label was asked for")

    monkeypatch.setattr(Teacher, "__init__", refuse)
    trainer = RewardTrainer(SMALL)
    before = {name: weights.clone() for name, weights in trainer.online.state_dict().items()}
    list(islice(trainer.train(), 4))
    assert any(not torch.equal(weights, before[name]) for name, weights in trainer.online.state_dict().items())
    assert trainer.metadata()["kind"] == "rewards"
    assert trainer.name == "tournet_rewards_skyline_easy"


def test_a_resumed_run_is_the_uninterrupted_one_bit_for_bit(tmp_path: Path) -> None:
    def state_of(trainer: RewardTrainer) -> dict[str, Any]:
        state = trainer.get_state()
        lines = [{name: value for name, value in line.items() if value == value} for line in state["history"]]
        for line in lines:
            del line["cpu_seconds"]
        untimed = {name: value for name, value in state.items() if name not in ("cpu_seconds", "history", "losses")}
        return untimed | {"history": lines, "losses": [(choice, last) for choice, _, last in state["losses"]]}

    config = replace(SMALL, updates=8)
    stopped = RewardTrainer(config)
    list(islice(stopped.train(), 5))
    save_checkpoint(tmp_path / "run.pth", stopped.get_state())
    resumed = RewardTrainer(replace(config, seed=9))
    resumed.config = config
    resumed.set_state(load_checkpoint(tmp_path / "run.pth"))
    assert_same(state_of(finished(RewardTrainer(config))), state_of(finished(resumed)))
