"""Statistics of the finished episodes of a task, with optima that are solved in the background."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import pytest

from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.flights.episodes import EpisodeSummary, analyse
from drone_env.flights.optima import solve_maps
from drone_env.flights.store import Store
from drone_env.models import OutcomeName
from drone_env.planning.optimal import solve
from tests.tools import PATIENCE, eventually
from tests.unit.stores import failing, flown


def test_an_analysis_looks_at_the_newest(store: Store) -> None:
    for actions in ("4", None, None):
        store.add_episode(flown(actions=actions), "someone")
    newest = store.analysis("easy", last=2)
    assert (newest.episodes_total, newest.episodes, newest.success_rate, newest.success_trend) == (3, 2, 1, 0)
    assert newest.mean_regret == 0


def test_an_analysis_does_not_wait_for_optima_and_has_them_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drone_env.flights.store.PATIENCE", 0)
    released, was_released = Event(), []

    def solve_when_released(task: TaskConfig, seeds: Sequence[int]) -> list[float | None]:
        was_released.append(released.wait(PATIENCE))
        return solve_maps(task, seeds)

    with (
        ThreadPoolExecutor(1) as solver,
        Store(tmp_path, submit=lambda task, seeds: solver.submit(solve_when_released, task, seeds)) as store,
    ):
        for seed in range(3):
            store.add_episode(flown("hard", seed, "4"), "someone")
        assert store.analysis("hard").regret_episodes == 0
        released.set()
        eventually(lambda: store.analysis("hard").regret_episodes == 3)
        assert all(was_released)


def test_what_is_known_is_told_where_optima_cannot_be_kept(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    store.add_episode(flown(), "someone")
    with failing(store.folder, "INSERT ON optima"):
        analysis = store.analysis("easy")
    assert (analysis.episodes, analysis.regret_episodes, analysis.mean_regret) == (1, 0, None)
    assert caplog.text.count("optima of easy_delivery could not be solved or stored: store ") == 1
    assert store.listed(9)[0].optimal_score == solve("easy", 7).score


def row(score: float, outcome: OutcomeName, actions: str, optimum: float | None) -> EpisodeSummary:
    flight = {"id": "0123456789abcdef", "task": "easy_delivery", "task_version": 1, "seed": 7, "actions": actions}
    ended = {"deliveries": int(outcome == "delivered"), "deliveries_total": 1, "steps": len(actions), "score": score}
    values = {**flight, **ended, "number": 1, "finished_at": 0.0, "reward_profile": "tiered", "agent": "someone"}
    solved = {"solved": True, "optimal_score": optimum}
    return EpisodeSummary(pilot="someone", reward_total=1.0, outcome=outcome, **values, **solved)


def test_maps_too_large_to_be_solved_are_left_out_of_regret() -> None:
    rows = [
        row(0.5, "battery_dead", "4" * 10, None),
        row(0.9, "delivered", "01234", 1.0 - 1 / 16),
        row(0.9, "delivered", "01234", None),
    ]
    analysis = analyse(TASKS["easy_delivery"], 5, rows)
    assert (analysis.episodes_total, analysis.episodes, analysis.regret_episodes) == (5, 3, 1)
    assert analysis.mean_regret == pytest.approx(0.9375 - 0.9)
    averages = (analysis.average_reward, analysis.average_score, analysis.average_steps, analysis.average_deliveries)
    assert averages == pytest.approx((1, 2.3 / 3, 20 / 3, 2 / 3))
    assert (analysis.deliveries, analysis.success_rate) == (2, pytest.approx(2 / 3))
    # The middle one of three belongs to neither half.
    assert analysis.success_trend == -1
    assert analysis.action_distribution["WAIT"] == 12 / 20
