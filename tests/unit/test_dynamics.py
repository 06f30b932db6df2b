"""Every rule of a step, its reward and its score, with numbers computed by hand."""

import pickle
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from drone_env.core import dynamics
from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.cells import Cell
from drone_env.core.rewards import get_reward_profile, interpreted_rewards
from drone_env.core.rules import interpreted, row_size
from drone_env.core.score import score_of
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import DroneEnvError, EpisodeError, InvalidValueError, UnknownNameError
from tests.toy import fly, toy_episode

STANDARD = [name for name in TASKS if name.endswith("_delivery")]
SKYLINE = [name for name in TASKS if name.startswith("skyline_")]
KINDS = [("B", Cell.BUILDING), ("T", Cell.TREE), ("O", Cell.OBSTACLE)]

LINE = ["@.BTO0.", "......."]
"""To the right of the drone: road, building, tree, obstacle, delivery."""


def rewards_of(task: str) -> dict[str, float]:
    """The `r_...` numbers of a standard task."""
    return {name: value for name, value in vars(TASKS[task]).items() if name.startswith("r_")}


def telemetry(episode: Episode) -> list[float]:
    return episode.observation()["telemetry"].tolist()


class TestMove:
    @pytest.mark.parametrize(
        ("action", "position"), [("U", (1, 0)), ("D", (1, 2)), ("L", (0, 1)), ("R", (2, 1)), ("W", (1, 1))]
    )
    def test_x_grows_rightwards_and_y_downwards(self, action: str, position: tuple[int, int]) -> None:
        episode = toy_episode(["...", ".@.", "..0"])
        fly(episode, action)
        assert episode.position == position

    def test_actions_are_numbered_up_down_left_right_wait(self) -> None:
        assert {action.name: int(action) for action in Action} == {"UP": 0, "DOWN": 1, "LEFT": 2, "RIGHT": 3, "WAIT": 4}

    def test_cell_ids_are_frozen(self) -> None:
        assert [(int(cell), cell.name.lower()) for cell in Cell][:8] == [
            (0, "road"),
            (1, "building"),
            (2, "tree"),
            (3, "obstacle"),
            (4, "delivery"),
            (5, "delivered"),
            (6, "drone"),
            (7, "unknown"),
        ]

    def test_grid_is_indexed_by_y_then_x(self) -> None:
        episode = toy_episode(["..@", "0.."])
        assert episode.grid().tolist() == [[0, 0, 6], [4, 0, 0]]

    @pytest.mark.parametrize(("letter", "kind"), KINDS)
    def test_drone_hides_the_cell_below_and_uncovers_it_on_leaving(self, letter: str, kind: Cell) -> None:
        episode = toy_episode([f"@{letter}.", "..0"])
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, 6, 0], [0, 0, 4]]
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, kind, 6], [0, 0, 4]]

    def test_delivered_cell_is_hidden_until_the_drone_leaves(self) -> None:
        episode = toy_episode(["@0.", "..1"])
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, 6, 0], [0, 0, 4]]
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, 5, 6], [0, 0, 4]]

    @pytest.mark.parametrize(
        ("drawing", "action", "position"),
        [
            (["@.", ".0"], "U", (0, 0)),
            (["@.", ".0"], "L", (0, 0)),
            (["0.", ".@"], "D", (1, 1)),
            (["0.", ".@"], "R", (1, 1)),
        ],
    )
    def test_wall_keeps_the_drone_in_place(self, drawing: list[str], action: str, position: tuple[int, int]) -> None:
        episode = toy_episode(drawing)
        assert fly(episode, action) == [0.32]
        assert (episode.position, episode.event) == (position, Event.WALL)

    @pytest.mark.parametrize(("letter", "kind"), KINDS)
    def test_impassable_kind_keeps_the_drone_in_place(self, letter: str, kind: Cell) -> None:
        episode = toy_episode([f"@{letter}0", "..."], impassable=frozenset({kind}))
        assert fly(episode, "R") == [0.33]
        assert (episode.position, episode.event) == ((0, 0), Event.BLOCKED)

    @pytest.mark.parametrize(
        ("letter", "event", "reward"),
        [("B", Event.BUILDING, 0.40), ("T", Event.TREE, 0.41), ("O", Event.OBSTACLE, 0.39)],
    )
    def test_passable_terrain_changes_only_the_reward(self, letter: str, event: Event, reward: float) -> None:
        episode = toy_episode([f"@{letter}0", "..."])
        assert fly(episode, "R") == [reward]
        assert (episode.position, episode.event, episode.battery_units) == ((1, 0), event, 9)


class TestBattery:
    @pytest.mark.parametrize("action", "UDLRW")
    def test_every_step_costs_one_unit_wait_and_bumps_too(self, action: str) -> None:
        episode = toy_episode(["@..", "..0"])
        fly(episode, action)
        assert (episode.steps, episode.battery_units, episode.battery) == (1, 9, 0.9)

    def test_blocked_step_costs_one_unit(self) -> None:
        episode = toy_episode(["@B0", "..."], impassable=frozenset({Cell.BUILDING}))
        fly(episode, "R")
        assert (episode.steps, episode.battery_units) == (1, 9)

    def test_drain_is_that_of_the_kind_below_after_the_move(self) -> None:
        episode = toy_episode(["@T.0", "...."], drain=((Cell.TREE, 3), (Cell.ROAD, 2)))
        fly(episode, "R")
        assert episode.battery_units == 7
        fly(episode, "R")
        assert episode.battery_units == 5

    def test_bump_drains_by_the_kind_that_the_drone_stays_above(self) -> None:
        episode = toy_episode(["@T.0", "...."], drain=((Cell.TREE, 3),))
        fly(episode, "RU")
        assert (episode.event, episode.battery_units) == (Event.WALL, 4)

    def test_drain_comes_before_the_delivery_changes_the_kind_below(self) -> None:
        episode = toy_episode(["@0.1", "...."], drain=((Cell.DELIVERY, 4), (Cell.DELIVERED, 2)))
        fly(episode, "R")
        assert episode.battery_units == 6
        fly(episode, "W")
        assert episode.battery_units == 4

    def test_drain_stops_at_zero(self) -> None:
        episode = toy_episode(["@T.0", "...."], drain=((Cell.TREE, 30),))
        fly(episode, "R")
        assert (episode.battery_units, episode.outcome) == (0, Outcome.BATTERY_DEAD)

    def test_drain_may_be_nothing(self) -> None:
        episode = toy_episode(["@..0", "...."], drain=((Cell.ROAD, 0),))
        fly(episode, "RW")
        assert (episode.steps, episode.battery_units) == (2, 10)

    def test_wait_on_a_pad_charges_without_drain_up_to_the_capacity(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=3)
        fly(episode, "RDUWW")
        assert [step.battery for step in episode.path] == [9, 8, 7, 10, 10]
        assert (episode.event, episode.steps) == (Event.WAIT, 5)

    def test_only_wait_charges(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=3)
        fly(episode, "RU")
        assert (episode.event, episode.battery_units) == (Event.WALL, 8)

    def test_wait_beside_a_pad_does_not_charge(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=3)
        fly(episode, "W")
        assert episode.battery_units == 9

    def test_pad_without_charge_rate_drains_like_road(self) -> None:
        episode = toy_episode(["@P0", "..."])
        fly(episode, "RW")
        assert episode.battery_units == 8


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

    def test_target_does_not_jump_to_one_that_has_become_nearer(self) -> None:
        episode = toy_episode(["0..@...1", "........"])
        fly(episode, "RR")
        assert (episode.target, episode.distance_to_target) == ((0, 0), 5)

    def test_delivery_of_another_target_does_not_make_the_nearest_one_current(self) -> None:
        episode = toy_episode(["@.02", "1..."])
        fly(episode, "RR")
        assert (episode.deliveries_done, episode.target, episode.distance_to_target) == (1, (0, 1), 3)

    def test_first_target_is_the_nearest(self) -> None:
        episode = toy_episode(["0..@.1", "......"])
        assert (episode.target, episode.distance_to_target) == ((5, 0), 2)

    def test_distance_to_the_target_is_manhattan(self) -> None:
        # As the crow flies, parcel 0 would be nearer: sqrt(8) against 3.
        episode = toy_episode(["@..1", "....", "..0."])
        assert (episode.target, episode.distance_to_target) == ((3, 0), 3)

    @pytest.mark.parametrize(("drawing", "first"), [(["0@1", "..."], (0, 0)), (["1@0", "..."], (2, 0))])
    def test_of_equally_near_targets_the_lowest_index_wins_at_the_start(
        self, drawing: list[str], first: tuple[int, int]
    ) -> None:
        assert toy_episode(drawing).target == first

    @pytest.mark.parametrize(("drawing", "second"), [([".@.", "102"], (0, 1)), ([".@.", "201"], (2, 1))])
    def test_of_equally_near_targets_the_lowest_index_wins_after_a_delivery(
        self, drawing: list[str], second: tuple[int, int]
    ) -> None:
        episode = toy_episode(drawing)
        fly(episode, "D")
        assert episode.target == second

    def test_after_a_delivery_the_nearest_from_there_is_next(self) -> None:
        # From the start parcel 2 is nearer than parcel 1.
        episode = toy_episode(["2...@.0.1", "........."])
        fly(episode, "RR")
        assert (episode.target, episode.distance_to_target) == ((8, 0), 2)

    def test_a_target_delivered_on_the_way_is_not_chosen_again(self) -> None:
        episode = toy_episode(["2..01@..", "........"])
        fly(episode, "LL")
        assert (episode.deliveries_done, episode.target) == (2, (0, 0))

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

    @pytest.mark.parametrize(
        "changes", [{"charge_rate": 1}, {"drain": ((Cell.TREE, 2),)}, {"drain": ((Cell.ROAD, 0),)}]
    )
    def test_steps_left_are_told_wherever_a_step_may_not_cost_one_unit(self, changes: dict[str, Any]) -> None:
        assert telemetry(toy_episode(["@.T0", ".P.."], **changes))[5] == 1

    @pytest.mark.parametrize("task", STANDARD)
    def test_has_five_float32_values_in_the_standard_tasks(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        values = episode.observation()["telemetry"]
        assert (values.shape, values.dtype) == ((5,), np.float32)

    @pytest.mark.parametrize("task", SKYLINE)
    def test_has_a_sixth_for_the_steps_left_in_the_skyline_tasks(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        for steps in range(3):
            values = episode.observation()["telemetry"]
            assert (values.shape, values.dtype) == ((6,), np.float32)
            assert values[5] == np.float32(1 - steps / TASKS[task].max_steps)
            episode.step(Action.WAIT)


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

    @pytest.mark.parametrize("task", STANDARD)
    def test_standard_task_ends_by_its_battery_at_max_steps(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        while not episode.ended:
            episode.step(Action.WAIT)
        assert (episode.steps, episode.outcome) == (TASKS[task].max_steps, Outcome.BATTERY_DEAD)

    @pytest.mark.parametrize("task", SKYLINE)
    def test_the_battery_of_a_skyline_task_does_not_last_for_its_steps(self, task: str) -> None:
        episode = Episode(task)
        episode.reset(0)
        while not episode.ended:
            episode.step(Action.WAIT)
        assert (episode.steps, episode.outcome) == (TASKS[task].battery_capacity, Outcome.BATTERY_DEAD)
        assert episode.steps < TASKS[task].max_steps

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
        assert episode.get_state() == before
        assert episode.message != message
        assert f"ended ({outcome})" in episode.message

    def test_the_functions_below_an_episode_refuse_it_too(self) -> None:
        task = replace(TASKS["easy_delivery"], max_steps=1)
        rules, rewards = interpreted(task), interpreted_rewards(task, get_reward_profile("tiered"))
        grid, row = memoryview(np.zeros(rules.cells, np.uint8)), memoryview(np.zeros(row_size(rules), np.uint16))
        dynamics.reset(rules, grid, row, 0)
        dynamics.step(rules, rewards, grid, row, Action.WAIT)
        before = grid.tobytes(), row.tobytes()
        for action in Action:
            assert dynamics.step(rules, rewards, grid, row, action) == 0
        assert (grid.tobytes(), row.tobytes()) == before

    def test_reset_after_a_refused_step_starts_afresh(self) -> None:
        episode = toy_episode(["@0", ".."])
        fly(episode, "RR")
        episode.reset(3)
        assert (episode.steps, episode.reward_total, episode.path, episode.ended) == (0, 0.0, [], False)
        assert "ended" not in episode.message


class TestEventPrecedence:
    """Delivery, battery_dead, wall, blocked, obstacle, building, tree, wait, step: the first that holds."""

    def test_order_of_the_events(self) -> None:
        names = [event.name.lower() for event in sorted(Event)]
        assert names[:5] == ["delivery", "battery_dead", "wall", "blocked", "obstacle"]
        assert names[5:] == ["building", "tree", "wait", "step", "none"]

    @pytest.mark.parametrize(
        ("letter", "event"), [("O", Event.OBSTACLE), ("B", Event.BUILDING), ("T", Event.TREE), (".", Event.WAIT)]
    )
    def test_wait_is_judged_by_the_cell_below(self, letter: str, event: Event) -> None:
        episode = toy_episode([f"@{letter}.", "..0"])
        fly(episode, "RW")
        assert episode.event == event

    @pytest.mark.parametrize("letter", "OBT")
    def test_bump_above_terrain_is_wall(self, letter: str) -> None:
        episode = toy_episode([f"@{letter}.", "..0"])
        fly(episode, "RU")
        assert episode.event == Event.WALL

    def test_bump_into_an_impassable_cell_above_terrain_is_blocked(self) -> None:
        episode = toy_episode(["@TB", "..0"], impassable=frozenset({Cell.BUILDING}))
        fly(episode, "RR")
        assert episode.event == Event.BLOCKED

    @pytest.mark.parametrize("actions", ["RU", "RR", "RW", "RL"])
    def test_battery_dead_beats_wall_blocked_terrain_and_step(self, actions: str) -> None:
        episode = toy_episode(["@TB", "..0"], impassable=frozenset({Cell.BUILDING}), max_steps=2)
        fly(episode, actions)
        assert episode.event == Event.BATTERY_DEAD

    def test_delivery_on_the_last_unit_with_others_left(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=1)
        assert fly(episode, "R") == [0.95]
        assert (episode.event, episode.outcome) == (Event.DELIVERY, Outcome.BATTERY_DEAD)
        assert (episode.success, episode.score) == (False, 0.40)

    def test_delivery_on_the_last_step_with_others_left(self) -> None:
        episode = toy_episode(["@0.1", "...."], max_steps=1, battery_capacity=4)
        fly(episode, "R")
        assert (episode.event, episode.outcome) == (Event.DELIVERY, Outcome.OUT_OF_STEPS)

    def test_flying_over_a_delivered_cell_or_a_pad_is_a_step(self) -> None:
        episode = toy_episode(["@0P1", "...."])
        fly(episode, "RLR")
        assert episode.event == Event.STEP
        fly(episode, "R")
        assert episode.event == Event.STEP


class TestTieredAndComposite:
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

    @pytest.mark.parametrize(
        ("task", "neither", "closer"),
        [("easy_delivery", 0.10, 0.15), ("medium_delivery", 0.15, 0.20), ("hard_delivery", 0.25, 0.30)],
    )
    @pytest.mark.parametrize("profile", ["tiered", "composite"])
    def test_battery_dead_pays_as_the_table_says(self, profile: str, task: str, neither: float, closer: float) -> None:
        assert fly(toy_episode(LINE, profile, max_steps=1, **rewards_of(task)), "W") == [neither]
        assert fly(toy_episode(LINE, profile, max_steps=1, **rewards_of(task)), "R") == [closer]

    def test_blocked_pays_as_the_table_says(self) -> None:
        episode = toy_episode(["@B0", "..."], impassable=frozenset({Cell.BUILDING}), **rewards_of("hard_delivery"))
        assert fly(episode, "R") == [0.25]

    def test_delivery_away_from_the_current_target(self) -> None:
        episode = toy_episode(["@.0", "1.."], **rewards_of("easy_delivery"))
        assert fly(episode, "RR") == [0.05, 0.90]

    def test_shaping_is_to_the_target_that_was_current_before_the_step(self) -> None:
        # The step reaches parcel 0 (closer by 1) and makes parcel 1 current, which is 6 away.
        assert fly(toy_episode(["@0.....1", "........"]), "R") == [0.95]

    @pytest.mark.parametrize(
        ("task", "delivery"), [("easy_delivery", 0.99), ("medium_delivery", 0.95), ("hard_delivery", 0.90)]
    )
    def test_composite(self, task: str, delivery: float) -> None:
        episode = toy_episode(LINE, "composite", max_steps=50, **rewards_of(task))
        assert fly(episode, "WU") == [0.01, 0.02]
        assert fly(episode, "RRRR") == [0.10, 0.07, 0.07, 0.07]
        assert fly(episode, "WU") == [0.02, 0.02]
        assert fly(episode, "LLL") == [0.01, 0.01, 0.01]  # 0.02 - 0.05 and 0.05 - 0.05 are clamped
        assert fly(episode, "RRRR") == [0.07, 0.07, 0.07, delivery]

    def test_composite_blocked(self) -> None:
        episode = toy_episode(["@B0", "..."], "composite", impassable=frozenset({Cell.BUILDING}))
        assert fly(episode, "R") == [0.02]

    def test_clamped_from_below(self) -> None:
        assert fly(toy_episode([".@0", "..."], r_step=0.02), "L") == [0.01]

    def test_clamped_from_above(self) -> None:
        assert fly(toy_episode([".@.0", "...."], r_step=0.95), "R") == [0.99]

    def test_rewards_just_inside_the_bounds_are_not_clamped(self) -> None:
        assert fly(toy_episode([".@.0", "...."], r_step=0.07), "L") == [0.02]
        assert fly(toy_episode([".@.0", "...."], r_step=0.93), "R") == [0.98]


class TestAlignedAndScore:
    """Width 3 and height 2, one parcel 2 cells away: phi = 0.2 + 0.8 * (1 - 2/5) = 0.68, one cell closer 0.84."""

    def test_aligned_pays_the_score_and_discounted_shaping(self) -> None:
        episode = toy_episode(["@.0", "..."], "aligned")
        first, last = fly(episode, "RR")
        assert first == pytest.approx(float(Fraction(99, 100) * Fraction(84, 100) - Fraction(68, 100)))  # 0.1516
        assert last == pytest.approx(0.96 - 0.84)  # phi is 0 at the end, the score 0.8 + 0.2 * 0.8

    def test_aligned_hovering_costs_the_difference_that_the_discount_makes(self) -> None:
        assert fly(toy_episode(["@.0", "..."], "aligned"), "WU") == pytest.approx([-0.0068, -0.0068])  # 0.68 * 0.01

    def test_aligned_away_is_not_clamped(self) -> None:
        # phi(s') = 0.2 + 0.8 * (1 - 3/5) = 0.52
        assert fly(toy_episode(["@.0", "..."], "aligned"), "D") == pytest.approx([0.99 * 0.52 - 0.68])  # -0.1652

    def test_aligned_failure_ends_with_potential_zero_and_the_clamped_score(self) -> None:
        assert fly(toy_episode(["@.0", "..."], "aligned", max_steps=1), "W") == pytest.approx([0.01 - 0.68])

    def test_aligned_delivery_counts_parcels_and_the_distance_to_the_next_target(self) -> None:
        # Before: phi = 0.2 + 0.4 * (1 - 1/6) = 8/15. After: phi = 0.2 + 0.4 * (2 - 2/6) = 13/15.
        reward = Fraction(99, 100) * Fraction(13, 15) - Fraction(8, 15)
        assert fly(toy_episode(["@0.1", "...."], "aligned"), "R") == pytest.approx([float(reward)])

    def test_aligned_delivery_of_another_target_keeps_the_distance_to_the_current_one(self) -> None:
        # Before the second step: phi = 0.2 + 0.4 * (1 - 2/5) = 11/25. After: phi = 0.2 + 0.4 * (2 - 3/5) = 19/25.
        reward = Fraction(99, 100) * Fraction(19, 25) - Fraction(11, 25)
        assert fly(toy_episode(["@.0", "1.."], "aligned"), "RR")[1] == pytest.approx(float(reward))

    def test_score_pays_nothing_before_the_end_and_the_score_there(self) -> None:
        assert fly(toy_episode(["@.0", "..."], "score"), "WRUR") == [0.0, 0.0, 0.0, 0.92]
        assert fly(toy_episode(["@.0", "..."], "score", max_steps=2), "WW") == [0.0, 0.01]

    @pytest.mark.parametrize("profile", ["aligned", "score"])
    def test_out_of_steps_pays_the_score_too(self, profile: str) -> None:
        # Battery 3/5, steps 2/2: 0.2 * 0.5 * 0.6 = 0.06; the rest is the potential 0.68 taken back.
        rewards = fly(toy_episode(["@.0", "..."], profile, max_steps=2, battery_capacity=5), "WW")
        assert rewards[1] == pytest.approx(0.06 - 0.68 if profile == "aligned" else 0.06)


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
        assert score_of(done, total, battery, capacity, steps, max_steps) == pytest.approx(score, rel=1e-15)

    def test_nothing_delivered_at_the_end_is_clamped_to_001(self) -> None:
        episode = toy_episode(["@.0", "..."], max_steps=2)
        fly(episode, "WW")
        assert episode.score == 0.01

    def test_just_above_the_lower_clamp(self) -> None:
        assert score_of(0, 1, 6, 100, 94, 100) == 0.012

    def test_nothing_exceeds_099(self) -> None:
        episode = toy_episode(["@0", ".."], max_steps=1000)
        fly(episode, "R")
        assert episode.score == 0.99  # 0.9998 before the clamp
        assert score_of(1, 1, 95, 100, 5, 100) == 0.99
        assert score_of(1, 1, 94, 100, 6, 100) == 0.988

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


class TestActionMask:
    def test_is_zero_for_walls(self) -> None:
        mask = toy_episode(["@.", ".0"]).action_mask()
        assert (mask.tolist(), mask.dtype) == ([0, 1, 0, 1, 1], np.int8)
        assert toy_episode(["0.", ".@"]).action_mask().tolist() == [1, 0, 1, 0, 1]

    @pytest.mark.parametrize(("letter", "kind"), KINDS)
    def test_is_zero_for_impassable_cells_only(self, letter: str, kind: Cell) -> None:
        drawing = ["...", f"{letter}@0", "..."]
        assert toy_episode(drawing).action_mask().tolist() == [1, 1, 1, 1, 1]
        assert toy_episode(drawing, impassable=frozenset({kind})).action_mask().tolist() == [1, 1, 0, 1, 1]

    def test_is_advice_and_never_enforced(self) -> None:
        episode = toy_episode(["@.", ".0"])
        assert fly(episode, "U") == [0.32]


class TestState:
    def test_round_trip(self) -> None:
        episode = toy_episode(["@0.1", "...."])
        fly(episode, "RL")
        state, message, observation = episode.get_state(), episode.message, episode.observation()
        onward = fly(episode, "RRR")
        assert episode.ended
        episode.set_state(state)
        assert episode.get_state() == state
        assert episode.message == message
        assert np.array_equal(episode.observation()["grid"], observation["grid"])
        assert np.array_equal(episode.observation()["telemetry"], observation["telemetry"])
        assert fly(episode, "RRR") == onward

    def test_a_snapshot_does_not_follow_the_flight(self) -> None:
        episode = toy_episode(["@0.1", "...."])
        state = episode.get_state()
        fly(episode, "R")
        assert episode.get_state() != state
        assert state == toy_episode(["@0.1", "...."]).get_state()

    def test_another_episode_can_go_on_from_a_snapshot(self) -> None:
        first, second = Episode("hard", "aligned"), Episode("hard", "aligned")
        first.reset(5)
        fly(first, "UUR")
        second.set_state(first.get_state())
        assert fly(second, "LLD") == fly(first, "LLD")
        assert second.get_state() == first.get_state()

    @pytest.mark.parametrize(("task", "profile"), [("medium", "tiered"), ("easy", "composite")])
    def test_a_snapshot_of_another_task_or_profile_is_refused(self, task: str, profile: str) -> None:
        other = Episode(task, profile)
        other.reset(1)
        episode = Episode("easy", "tiered")
        episode.reset(2)
        before = episode.get_state()
        with pytest.raises(InvalidValueError, match=f"{task}_delivery.*{profile}.*easy_delivery.*tiered"):
            episode.set_state(other.get_state())
        assert episode.get_state() == before

    def test_a_snapshot_can_be_pickled(self) -> None:
        episode = toy_episode(["@0.1", "...."], "composite")
        fly(episode, "R")
        state = pickle.loads(pickle.dumps(episode.get_state()))
        assert state == episode.get_state()
        fly(episode, "R")
        episode.set_state(state)
        assert episode.get_state() == state

    def test_observation_is_a_copy(self) -> None:
        episode = toy_episode(["@0", ".."])
        episode.observation()["grid"][:] = 0
        assert episode.grid().tolist() == [[6, 4], [0, 0]]

    def test_before_the_first_reset_there_is_nothing_to_fly(self) -> None:
        episode = Episode()
        for call in (lambda: episode.step(0), lambda: episode.seed, episode.get_state):
            with pytest.raises(EpisodeError, match="reset"):
                call()
        assert "reset" in episode.message

    def test_path_and_rewards_are_recorded(self) -> None:
        episode = toy_episode(["@T0", "..."], battery_capacity=8)
        fly(episode, "URR")
        assert [tuple(step) for step in episode.path] == [
            (Action.UP, 0, 0, Event.WALL, 0.32, 7),
            (Action.RIGHT, 1, 0, Event.TREE, 0.41, 6),
            (Action.RIGHT, 2, 0, Event.DELIVERY, 0.95, 5),
        ]
        assert episode.actions == [0, 3, 3]
        assert episode.reward_last == 0.95
        assert episode.reward_total == pytest.approx(1.68)


class TestRefusedInput:
    @pytest.mark.parametrize("action", [5, -1, 1.5, "UP", "0", None, [0]])
    def test_invalid_action_leaves_the_state_as_it_was(self, action: Any) -> None:
        episode = toy_episode(["@.0", "..."])
        before = episode.get_state()
        with pytest.raises(InvalidValueError, match="0 UP, 1 DOWN, 2 LEFT, 3 RIGHT, 4 WAIT"):
            episode.step(action)
        assert episode.get_state() == before

    @pytest.mark.parametrize("action", [3, np.int64(3), np.uint8(3), Action.RIGHT])
    def test_any_integer_type_is_an_action(self, action: Any) -> None:
        episode = toy_episode(["@.0", "..."])
        episode.step(action)
        assert episode.position == (1, 0)

    @pytest.mark.parametrize("seed", [True, False, -1, 2**53, 2**64, 1.5, 7.0, "7", [7]])
    def test_invalid_seed_leaves_the_state_as_it_was(self, seed: Any) -> None:
        episode = toy_episode(["@.0", "..."])
        fly(episode, "R")
        before = episode.get_state()
        with pytest.raises(InvalidValueError, match="seed must be an integer"):
            episode.reset(seed)
        assert episode.get_state() == before

    @pytest.mark.parametrize("seed", [0, 2**53 - 1, np.int64(7), np.uint32(7)])
    def test_any_integer_type_is_a_seed(self, seed: Any) -> None:
        episode = Episode()
        assert episode.reset(seed) == episode.seed == int(seed)
        assert type(episode.seed) is int

    def test_unknown_reward_profile_lists_the_valid_ones(self) -> None:
        with pytest.raises(UnknownNameError, match="'no_such'; allowed: aligned, composite, score, tiered"):
            Episode("easy", "no_such")


class TestReset:
    def test_without_a_seed_the_first_map_is_drawn_from_the_train_split(self) -> None:
        seeds = {Episode().reset() for _ in range(20)}
        assert len(seeds) == 20
        assert all(0 <= seed < 2**52 for seed in seeds)

    def test_without_a_seed_further_maps_follow_the_walk(self) -> None:
        episode = Episode()
        episode.reset(11)
        walk = [episode.reset() for _ in range(4)]
        expected, seed = [], 11
        for _ in range(4):
            seed = next_seed(seed)
            expected.append(seed)
        assert walk == expected

    @pytest.mark.parametrize("split", SPLITS)
    def test_the_walk_never_leaves_the_train_split_wherever_it_starts(self, split: str) -> None:
        for start in (SPLITS[split].start, SPLITS[split].stop - 1):
            seed, seen = start, set()
            for _ in range(1000):
                seed = next_seed(seed)
                assert 0 <= seed < 2**52
                seen.add(seed)
            assert len(seen) == 1000

    def test_starts_full_and_undelivered(self) -> None:
        episode = Episode("hard")
        episode.reset(4)
        assert (episode.steps, episode.battery_units, episode.deliveries_done) == (0, 160, 0)
        assert (episode.event, episode.outcome, episode.under) == (Event.NONE, Outcome.FLYING, Cell.ROAD)
        x, y = episode.position
        tx, ty = episode.target or (-1, -1)
        distances = [abs(px - x) + abs(py - y) for px, py, _ in episode.parcels]
        assert episode.distance_to_target == min(distances) == abs(tx - x) + abs(ty - y)
        assert episode.parcels[distances.index(min(distances))] == (tx, ty, False)

    def test_the_reward_profile_is_chosen_per_episode_and_kept_until_another_is(self) -> None:
        episode = Episode("easy", "tiered")
        episode.reset(1, "score")
        assert (episode.reward_profile.id, episode.get_state().reward_profile.id) == ("score", "score")
        assert fly(episode, "W") == [0.0]
        episode.reset(2)
        assert episode.reward_profile.id == "score"
        assert fly(episode, "W") == [0.0]

    @pytest.mark.parametrize("arguments", [(2, "no_such"), (-1, "score")])
    def test_a_refused_reset_keeps_the_episode_and_its_profile(self, arguments: tuple[int, str]) -> None:
        episode = Episode("easy", "tiered")
        episode.reset(1)
        before = episode.get_state()
        with pytest.raises(DroneEnvError):
            episode.reset(*arguments)
        assert episode.get_state() == before

    def test_equal_seed_gives_the_equal_start_whatever_was_flown_before(self) -> None:
        fresh, used = Episode(), Episode()
        fresh.reset(9)
        used.reset(1)
        fly(used, "UDLRWRRDD")
        used.reset(9)
        assert used.get_state() == fresh.get_state()
