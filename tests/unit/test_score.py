"""The graded score, by hand."""

from dataclasses import replace

import pytest

from drone_env.core.episode import Episode
from drone_env.core.rules import score_of
from drone_env.core.tables import interpreted
from drone_env.core.tasks import TASKS
from tests.toy import TOY, fly, toy_episode

STANDARD = [name for name in TASKS if name.endswith("_delivery")]
SKYLINE = [name for name in TASKS if name.startswith("skyline_")]


def score_by_hand(done: int, total: int, battery: int, capacity: int, steps: int, max_steps: int) -> float:
    task = replace(TOY, width=4, height=4, deliveries=total, battery_capacity=capacity, max_steps=max_steps)
    return score_of(interpreted(task), done, battery, steps)


class TestScore:
    @pytest.mark.parametrize(
        ("done", "total", "battery", "capacity", "steps", "max_steps", "score"),
        [
            (0, 1, 60, 60, 0, 60, 0.20),
            (1, 1, 0, 60, 60, 60, 0.80),
            (1, 1, 48, 60, 12, 60, 0.96),
            (1, 3, 0, 100, 100, 100, 0.8 / 3),
            (2, 3, 30, 100, 70, 100, 1.78 / 3),
            (3, 5, 80, 160, 80, 160, 0.58),
            (0, 1, 3, 5, 2, 4, 0.11),
            (1, 2, 5, 10, 30, 40, 0.475),
        ],
    )
    def test_formula(
        self, done: int, total: int, battery: int, capacity: int, steps: int, max_steps: int, score: float
    ) -> None:
        assert score_by_hand(done, total, battery, capacity, steps, max_steps) == pytest.approx(score, rel=1e-15)

    def test_nothing_delivered_at_the_end_is_clamped_to_001(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2)
        fly(episode, "WW")
        assert episode.score == 0.01

    def test_just_above_the_lower_clamp(self) -> None:
        assert score_by_hand(0, 1, 6, 100, 94, 100) == 0.012

    def test_nothing_exceeds_099(self) -> None:
        episode = toy_episode(["@0", ".."], max_steps=1000)
        fly(episode, "R")
        assert episode.score == 0.99  # 0.9998 before the clamp
        assert score_by_hand(1, 1, 95, 100, 5, 100) == 0.99
        assert score_by_hand(1, 1, 94, 100, 6, 100) == 0.988

    @pytest.mark.parametrize("task", STANDARD)
    def test_is_provisionally_020_at_reset_and_counts_001(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        assert (episode.score, episode.counted_score()) == (0.20, 0.01)

    @pytest.mark.parametrize("task", SKYLINE)
    def test_is_001_at_reset_where_efficiency_needs_all(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        assert (episode.score, episode.counted_score()) == (0.01, 0.01)

    def test_where_efficiency_needs_all_it_counts_from_the_last_delivery_on(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10, efficiency_needs_all=True)
        scores = []
        for action in "RRR":
            fly(episode, action)
            scores.append(episode.score)
        assert scores == [0.40, 0.40, 0.9325]  # 0.8 + 0.2 * (0.5 * 7/10 + 0.5 * 5/8)

    def test_provisional_score_follows_battery_and_steps(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=4, battery_capacity=5)
        fly(episode, "WW")
        assert episode.score == 0.11  # 0.2 * (0.5 * 3/5 + 0.5 * 2/4)

    def test_counted_score_keeps_what_was_delivered_and_leaves_the_episode_alone(self) -> None:
        episode = toy_episode(["@0.1", "...."])
        fly(episode, "R")
        before = episode.get_state()
        assert episode.counted_score() == 0.40
        assert episode.get_state() == before
        fly(episode, "RR")
        assert episode.counted_score() == episode.score == 0.94

    def test_counted_score_waits_on_a_pad_if_the_drone_is_there(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=1, max_steps=5)
        fly(episode, "R")
        assert episode.counted_score() == 0.10  # full battery, out of steps


class TestEfficiency:
    def test_is_75_parts_parcels_15_battery_and_10_steps(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10)
        assert (episode.efficiency, episode.efficiency_shares) == (25, (0, 1, 1))
        fly(episode, "R")
        assert episode.efficiency_shares == (1 / 2, 9 / 10, 7 / 8)
        assert episode.efficiency == pytest.approx(75 / 2 + 15 * 9 / 10 + 10 * 7 / 8)
