"""How an episode ends, and what a step after the end does; by hand."""

from dataclasses import replace

import numpy as np
import pytest

from drone_env.core import rules
from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile, interpreted_rewards
from drone_env.core.tables import interpreted, state_size
from drone_env.core.tasks import TASKS
from tests.toy import fly, toy_episode

STANDARD = [name for name in TASKS if name.endswith("_delivery")]
SKYLINE = [name for name in TASKS if name.startswith("skyline_")]


def telemetry(episode: Episode) -> list[float]:
    return episode.observation()["telemetry"].tolist()


class TestEnd:
    def test_all_delivered(self) -> None:
        episode = toy_episode(["@01", "..."])
        fly(episode, "R")
        assert (episode.outcome, episode.ended) == (Outcome.FLYING, False)
        fly(episode, "R")
        assert (episode.outcome, episode.ended, episode.success) == (Outcome.DELIVERED, True, True)

    def test_where_both_coincide_the_end_is_battery_dead(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2)
        assert fly(episode, "WW") == [0.37, 0.31]
        assert (episode.event, episode.outcome, episode.success) == (Event.BATTERY_DEAD, Outcome.BATTERY_DEAD, False)

    def test_battery_dead_before_the_steps_run_out(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=5, battery_capacity=2)
        assert fly(episode, "WW") == [0.37, 0.31]
        assert (episode.outcome, episode.steps) == (Outcome.BATTERY_DEAD, 2)

    def test_out_of_steps_with_battery_left_pays_the_event_of_the_step(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2, battery_capacity=5)
        assert fly(episode, "WW") == [0.37, 0.37]
        assert (episode.event, episode.outcome, episode.battery_units) == (Event.WAIT, Outcome.OUT_OF_STEPS, 3)
        assert telemetry(episode)[5] == 0

    def test_last_delivery_on_the_last_step_is_a_success(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2, battery_capacity=5)
        fly(episode, "RR")
        assert episode.outcome == Outcome.DELIVERED

    @pytest.mark.parametrize(
        ("drawing", "actions", "outcome"),
        [
            (["@0", ".."], "R", "delivered"),
            (["@.0", "..."], "WW", "battery_dead"),
            (["@.0P", "...."], "WW", "out_of_steps"),
        ],
    )
    @pytest.mark.parametrize("further", "UDLRW")
    def test_a_step_after_the_end_changes_nothing_pays_nothing_and_says_so(
        self, drawing: list[str], actions: str, outcome: str, further: str
    ) -> None:
        capacity = 5 if outcome == "out_of_steps" else 2
        episode = toy_episode(drawing, max_steps=2, battery_capacity=capacity)
        fly(episode, actions)
        before, message = episode.get_state(), episode.message
        assert fly(episode, further) == [0.0]
        assert episode.reward_last == 0
        assert episode.get_state() == before
        assert episode.message != message
        assert f"ended ({outcome})" in episode.message

    def test_the_functions_below_an_episode_refuse_it_too(self) -> None:
        task = replace(TASKS["easy_delivery"], max_steps=1)
        tables, rewards = interpreted(task), interpreted_rewards(task, get_reward_profile("tiered"))
        grid, state = memoryview(np.zeros(tables.cells, np.uint8)), memoryview(np.zeros(state_size(tables), np.uint16))
        rules.reset(tables, grid, state, 0)
        rules.step(tables, rewards, grid, state, Action.WAIT)
        before = grid.tobytes(), state.tobytes()
        for action in Action:
            assert rules.step(tables, rewards, grid, state, action) == 0
        assert (grid.tobytes(), state.tobytes()) == before

    def test_reset_after_a_refused_step_starts_afresh(self) -> None:
        episode = toy_episode(["@0", ".."])
        fly(episode, "RR")
        episode.reset(3)
        assert (episode.steps, episode.reward_total, episode.path, episode.ended) == (0, 0.0, [], False)
        assert "ended" not in episode.message
