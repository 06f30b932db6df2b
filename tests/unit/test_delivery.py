"""Parcels, targets, and what telemetry tells of them; by hand."""

import numpy as np
import pytest

from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from tests.toy import fly, toy_episode

STANDARD = [name for name in TASKS if name.endswith("_delivery")]
SKYLINE = [name for name in TASKS if name.startswith("skyline_")]


def telemetry(episode: Episode) -> list[float]:
    return episode.observation()["telemetry"].tolist()


class TestDelivery:
    def test_delivery_on_the_last_unit_counts_and_scores_080(self) -> None:
        episode = toy_episode(["@0", ".."], max_steps=1)
        assert fly(episode, "R") == [0.95]
        assert (episode.event, episode.outcome, episode.success) == (Event.DELIVERY, Outcome.DELIVERED, True)
        assert (episode.battery_units, episode.score) == (0, 0.80)

    def test_passing_over_another_target_delivers_it_and_the_current_one_does_not_jump(self) -> None:
        episode = toy_episode(["@.0", "1.."])
        assert episode.target == (0, 1)
        fly(episode, "R")
        assert episode.target == (0, 1)
        assert fly(episode, "R") == [0.85]  # 0.90 for the delivery, 0.05 off for flying away from the current target
        assert (episode.event, episode.deliveries_done) == (Event.DELIVERY, 1)
        assert episode.parcels == [(2, 0, True), (0, 1, False)]
        assert (episode.target, episode.distance_to_target) == ((0, 1), 3)

    def test_delivery_of_another_target_does_not_make_the_nearest_one_current(self) -> None:
        episode = toy_episode(["@.02", "1..."])
        fly(episode, "RR")
        assert (episode.deliveries_done, episode.target, episode.distance_to_target) == (1, (0, 1), 3)

    @pytest.mark.parametrize(("drawing", "second"), [([".@.", "102"], (0, 1)), ([".@.", "201"], (2, 1))])
    def test_of_equally_near_targets_the_lowest_index_wins_after_a_delivery(
        self, drawing: list[str], second: tuple[int, int]
    ) -> None:
        episode = toy_episode(drawing)
        fly(episode, "D")
        assert episode.target == second

    def test_a_cell_delivers_only_once(self) -> None:
        episode = toy_episode(["@0.1", "...."])
        fly(episode, "RW")
        assert (episode.event, episode.deliveries_done) == (Event.WAIT, 1)
        fly(episode, "LR")
        assert (episode.event, episode.deliveries_done) == (Event.STEP, 1)

    def test_no_target_is_left_at_the_end_and_telemetry_repeats_the_own_position(self) -> None:
        episode = toy_episode(["....", "@0.."])
        fly(episode, "R")
        assert (episode.target, episode.distance_to_target) == (None, None)
        assert telemetry(episode) == pytest.approx([0.25, 0.5, 0.9, 0.25, 0.5])


class TestTelemetry:
    def test_is_own_position_battery_and_target_position(self) -> None:
        episode = toy_episode(["...@", "....", "0...", "....", "...."])
        fly(episode, "D")
        assert telemetry(episode) == pytest.approx([3 / 4, 1 / 5, 0.9, 0, 2 / 5])

    def test_has_a_sixth_value_the_steps_left_where_the_battery_does_not_tell_the_time(self) -> None:
        episode = toy_episode(["@..0", "...."], max_steps=4, battery_capacity=8)
        fly(episode, "R")
        assert telemetry(episode) == pytest.approx([0.25, 0, 7 / 8, 0.75, 0, 0.75])

    @pytest.mark.parametrize("task", SKYLINE)
    def test_has_the_steps_left_and_the_cell_below_in_the_skyline_tasks(self, task: str) -> None:
        episode = Episode(task, seed=0)
        for steps in range(3):
            values = episode.observation()["telemetry"]
            assert (values.shape, values.dtype) == ((13,), np.float32)
            assert values[5] == np.float32(1 - steps / TASKS[task].max_steps)
            assert values[6:].tolist() == [1, 0, 0, 0, 0, 0, 0]
            episode.step(Action.WAIT)

    def test_tells_the_kind_below_where_there_are_pads(self) -> None:
        episode = toy_episode(["@BTP0.1", "......."])
        seen = [telemetry(episode)[6:]]
        while not episode.ended:
            episode.step(Action.RIGHT)
            seen.append(telemetry(episode)[6:])
        kinds = ["road", "building", "tree", "pad", "delivered", "road", "delivered"]
        order = ["road", "building", "tree", "obstacle", "delivery", "delivered", "pad"]
        assert seen == [[float(name == kind) for name in order] for kind in kinds]
