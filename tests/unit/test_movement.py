"""Moves, walls, what blocks and what lies below, and which event a step comes to; by hand."""

import pytest

from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.cells import Cell
from tests.toy import fly, toy_episode

KINDS = [("B", Cell.BUILDING), ("T", Cell.TREE), ("O", Cell.OBSTACLE)]


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

    @pytest.mark.parametrize(("letter", "kind"), KINDS)
    def test_drone_hides_the_cell_below_and_uncovers_it_on_leaving(self, letter: str, kind: Cell) -> None:
        episode = toy_episode([f"@{letter}.", "..0"])
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, 6, 0], [0, 0, 4]]
        fly(episode, "R")
        assert episode.grid().tolist() == [[0, kind, 6], [0, 0, 4]]

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


class TestActionMask:
    @pytest.mark.parametrize(("letter", "kind"), KINDS)
    def test_is_zero_for_impassable_cells_only(self, letter: str, kind: Cell) -> None:
        drawing = ["...", f"{letter}@0", "..."]
        assert toy_episode(drawing).action_mask().tolist() == [1, 1, 1, 1, 1]
        assert toy_episode(drawing, impassable=frozenset({kind})).action_mask().tolist() == [1, 1, 0, 1, 1]


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
