"""The graded score, by hand."""

import pytest

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from tests.toy import fly, toy_episode

STANDARD = [name for name in TASKS if name.endswith("_delivery")]
SKYLINE = [name for name in TASKS if name.startswith("skyline_")]


class TestScore:
    def test_nothing_delivered_at_the_end_is_clamped_to_001(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2)
        fly(episode, "WW")
        assert episode.score == 0.01

    def test_nothing_exceeds_099(self) -> None:
        episode = toy_episode(["@0", ".."], max_steps=1000)
        fly(episode, "R")
        assert episode.score == 0.99  # 0.9998 before the clamp

    @pytest.mark.parametrize("task", STANDARD)
    def test_is_provisionally_020_at_reset_and_counts_001(self, task: str) -> None:
        episode = Episode(task, seed=0)
        assert (episode.score, episode.counted_score()) == (0.20, 0.01)

    @pytest.mark.parametrize("task", SKYLINE)
    def test_is_001_at_reset_where_efficiency_needs_all(self, task: str) -> None:
        episode = Episode(task, seed=0)
        assert (episode.score, episode.counted_score()) == (0.01, 0.01)

    def test_where_efficiency_needs_all_it_counts_from_the_last_delivery_on(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10, efficiency_needs_all=True)
        scores = []
        for action in "RRR":
            fly(episode, action)
            scores.append(episode.score)
        assert scores == [0.40, 0.40, 0.9325]  # 0.8 + 0.2 * (0.5 * 7/10 + 0.5 * 5/8)

    def test_counted_score_keeps_what_was_delivered_and_leaves_the_episode_alone(self) -> None:
        episode = toy_episode(["@0.1", "...."])
        fly(episode, "R")
        before = episode.get_state()
        assert episode.counted_score() == 0.40
        assert episode.get_state() == before
        fly(episode, "RR")
        assert episode.counted_score() == episode.score == 0.94


class TestEfficiency:
    def test_is_75_parts_parcels_15_battery_and_10_steps(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10)
        assert (episode.efficiency, episode.efficiency_shares) == (25, (0, 1, 1))
        fly(episode, "R")
        assert episode.efficiency_shares == (1 / 2, 9 / 10, 7 / 8)
        assert episode.efficiency == pytest.approx(75 / 2 + 15 * 9 / 10 + 10 * 7 / 8)
