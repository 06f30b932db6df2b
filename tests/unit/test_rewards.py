"""What a step pays under each profile, by hand."""

from fractions import Fraction

import pytest

from drone_env.core.batch import Batch
from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE, ORIGINAL_PROFILE, REWARD_PROFILES
from drone_env.core.tasks import TASKS
from drone_env.rl.config import TrainConfig
from tests.toy import fly, toy_episode

LINE = ["@.BTO0.", "......."]
"""To the right of the drone: road, building, tree, obstacle, delivery."""


def rewards_of(task: str) -> dict[str, float]:
    """The `r_...` numbers of a standard task."""
    return {name: value for name, value in vars(TASKS[task]).items() if name.startswith("r_")}


def test_where_nobody_says_it_an_episode_and_a_batch_pay_what_training_does() -> None:
    assert Episode().reward_profile is Batch("easy", 1).reward_profile is REWARD_PROFILES[DEFAULT_PROFILE]
    assert (TrainConfig().reward_profile, DEFAULT_PROFILE, ORIGINAL_PROFILE) == ("aligned", "aligned", "tiered")


class TestTieredAndComposite:
    @pytest.mark.feature("E7")
    @pytest.mark.parametrize(
        ("task", "closer", "away", "neither", "delivery"),
        [
            ("easy_delivery", 0.15, 0.05, 0.10, 0.99),  # 0.95 + 0.05 is clamped
            ("medium_delivery", 0.20, 0.10, 0.15, 0.95),
            ("hard_delivery", 0.30, 0.20, 0.25, 0.90),
        ],
    )
    def test_tiered_pays_exact_decimals(
        self, task: str, closer: float, away: float, neither: float, delivery: float
    ) -> None:
        episode = toy_episode(LINE, max_steps=50, **rewards_of(task))
        assert fly(episode, "RRRR") == [closer] * 4
        assert fly(episode, "LLL") == [away] * 3
        assert fly(episode, "UWRW") == [neither, neither, closer, neither]
        assert fly(episode, "RRR") == [closer, closer, delivery]

    @pytest.mark.parametrize("profile", ["tiered", "composite"])
    def test_battery_dead_pays_as_the_table_says(self, profile: str) -> None:
        for actions, reward in (("W", 0.25), ("R", 0.30)):
            assert fly(toy_episode(LINE, profile, max_steps=1, **rewards_of("hard_delivery")), actions) == [reward]

    def test_delivery_away_from_the_current_target(self) -> None:
        episode = toy_episode(["@.0", "1.."], **rewards_of("easy_delivery"))
        assert fly(episode, "RR") == [0.05, 0.90]

    def test_shaping_is_to_the_target_that_was_current_before_the_step(self) -> None:
        # The step reaches parcel 0 (closer by 1) and makes parcel 1 current, which is 6 away.
        assert fly(toy_episode(["@0.....1", "........"]), "R") == [0.95]

    def test_composite(self) -> None:
        episode = toy_episode(LINE, "composite", max_steps=50, **rewards_of("medium_delivery"))
        assert fly(episode, "WU") == [0.01, 0.02]
        assert fly(episode, "RRRR") == [0.10, 0.07, 0.07, 0.07]
        assert fly(episode, "WU") == [0.02, 0.02]
        assert fly(episode, "LLL") == [0.01, 0.01, 0.01]  # 0.02 - 0.05 and 0.05 - 0.05 are clamped
        assert fly(episode, "RRRR") == [0.07, 0.07, 0.07, 0.95]


class TestAlignedAndScore:
    """Width 3 and height 2, one parcel 2 cells away: phi = 0.2 + 0.8 * (1 - 2/5) = 0.68, one cell closer 0.84."""

    def test_aligned_pays_the_score_and_discounted_shaping(self) -> None:
        episode = toy_episode(["@.0", "..."], "aligned")
        first, last = fly(episode, "RR")
        assert first == pytest.approx(float(Fraction(99, 100) * Fraction(84, 100) - Fraction(68, 100)))  # 0.1516
        assert last == pytest.approx(0.96 - 0.84)  # phi is 0 at the end, the score 0.8 + 0.2 * 0.8

    def test_aligned_delivery_counts_parcels_and_the_distance_to_the_next_target(self) -> None:
        # Before: phi = 0.2 + 0.4 * (1 - 1/6) = 8/15. After: phi = 0.2 + 0.4 * (2 - 2/6) = 13/15.
        reward = Fraction(99, 100) * Fraction(13, 15) - Fraction(8, 15)
        assert fly(toy_episode(["@0.1", "...."], "aligned"), "R") == pytest.approx([float(reward)])

    def test_score_pays_nothing_before_the_end_and_the_score_there(self) -> None:
        assert fly(toy_episode(["@.0", "..."], "score"), "WRUR") == [0.0, 0.0, 0.0, 0.92]
        assert fly(toy_episode(["@.0", "..."], "score", max_steps=2), "WW") == [0.0, 0.01]
