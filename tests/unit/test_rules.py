"""Moves, events, battery and endings: what flights over toy maps come to, by hand."""

from typing import Any

import pytest

from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.cells import Cell
from tests.toy import fly, toy_episode

KINDS = [("B", Cell.BUILDING, Event.BUILDING), ("T", Cell.TREE, Event.TREE), ("O", Cell.OBSTACLE, Event.OBSTACLE)]
TALL = {"impassable": frozenset({Cell.BUILDING})}


def test_the_order_of_actions_events_and_cells_is_frozen() -> None:
    assert [action.name for action in Action] == ["UP", "DOWN", "LEFT", "RIGHT", "WAIT"]
    events = "delivery battery_dead wall blocked obstacle building tree wait step none"
    assert [event.name.lower() for event in Event] == events.split()
    cells = "road building tree obstacle delivery delivered drone unknown pad"
    assert [cell.name.lower() for cell in Cell] == cells.split()
    assert [list(kinds) == list(range(len(kinds))) for kinds in (Action, Event, Cell)] == [True] * 3


CASES: dict[str, tuple[list[str], str, dict[str, Any], dict[str, Any]]] = {
    "up and to the left": (["...", ".@.", "..0"], "UL", {}, {"position": (0, 0), "steps": 2}),
    "down and to the right": (["...", ".@.", "0.."], "DRW", {}, {"position": (2, 2), "steps": 3}),
    "wall above": (["@.", ".0"], "U", {}, {"position": (0, 0), "event": Event.WALL, "reward_last": 0.32}),
    # The first event that holds
    "wall above terrain": (["@T.", "..0"], "RU", {}, {"event": Event.WALL}),
    "blocked above terrain": (["@TB", "..0"], "RR", TALL, {"event": Event.BLOCKED, "position": (1, 0)}),
    "dead at a wall": (["@TB", "..0"], "RU", TALL | {"max_steps": 2}, {"event": Event.BATTERY_DEAD}),
    "delivered with the last unit": (["@0.1", "...."], "R", {"max_steps": 1}, {"outcome": Outcome.BATTERY_DEAD}),
    "all parcels with the last unit": (["@0", ".."], "R", {"max_steps": 1}, {"outcome": Outcome.DELIVERED}),
    # The nearest parcel
    "the lowest index of equally near parcels": (["1@0", "..2"], "D", {}, {"target": (2, 0)}),
    "the nearest parcel after a delivery": (["1.@0", "...2"], "R", {}, {"target": (3, 1)}),
    # Battery
    "drain of the cell that is reached": (["@T.0", "...."], "R", {"drain": ((Cell.TREE, 3),)}, {"battery_units": 7}),
    "drain before the delivery": (["@0.1", "...."], "R", {"drain": ((Cell.DELIVERY, 4),)}, {"battery_units": 6}),
    "a pad fills no more than the battery": (["@P0", "..."], "RDUWW", {"charge_rate": 3}, {"battery_units": 10}),
    "only waiting charges": (["@P0", "..."], "RU", {"charge_rate": 3}, {"battery_units": 8, "event": Event.WALL}),
    # Endings
    "all parcels": (["@01", "..."], "RR", {}, {"outcome": Outcome.DELIVERED, "ended": True, "success": True}),
    "battery and steps end together": (
        ["@.0", "..."],
        "WW",
        {"max_steps": 2},
        {"event": Event.BATTERY_DEAD, "outcome": Outcome.BATTERY_DEAD, "success": False, "rewards": [0.37, 0.31]},
    ),
    "the steps end first": (
        ["@.0", "..."],
        "WW",
        {"max_steps": 2, "battery_capacity": 5},
        {"event": Event.WAIT, "outcome": Outcome.OUT_OF_STEPS, "battery_units": 3, "rewards": [0.37, 0.37]},
    ),
}


@pytest.mark.feature("E3", "E8")
@pytest.mark.parametrize("case", CASES)
def test_by_hand(case: str) -> None:
    drawing, actions, changes, expected = CASES[case]
    episode = toy_episode(drawing, **changes)
    fly(episode, actions)
    assert {name: getattr(episode, name) for name in expected} == expected


@pytest.mark.parametrize(("letter", "kind", "event"), KINDS)
def test_each_kind_of_terrain(letter: str, kind: Cell, event: Event) -> None:
    episode = toy_episode([f"@{letter}.", "..0"])
    fly(episode, "RW")
    assert episode.event == event
    assert episode.grid().tolist() == [[0, 6, 0], [0, 0, 4]]
    fly(episode, "R")
    assert episode.grid().tolist() == [[0, kind, 6], [0, 0, 4]]
    assert toy_episode([f"@{letter}0", "..."]).action_mask().tolist() == [0, 1, 0, 1, 1]
    closed = toy_episode([f"@{letter}0", "..."], impassable=frozenset({kind}))
    assert closed.action_mask().tolist() == [0, 1, 0, 0, 1]
    assert fly(closed, "R") == [0.33]
    assert (closed.position, closed.event) == ((0, 0), Event.BLOCKED)


@pytest.mark.parametrize("case", ["all parcels", "battery and steps end together", "the steps end first"])
def test_a_step_after_the_end_changes_nothing_pays_nothing_and_says_so(case: str) -> None:
    drawing, actions, changes, expected = CASES[case]
    episode = toy_episode(drawing, **changes)
    fly(episode, actions)
    before = episode.get_state()
    for further in "UDLRW":
        assert fly(episode, further) == [0.0]
        assert episode.reward_last == 0
        assert episode.get_state() == before
        assert f"ended ({expected['outcome'].name.lower()})" in episode.message
    episode.reset(3)
    assert (episode.steps, episode.reward_total, episode.path, episode.ended) == (0, 0.0, [], False)
    assert "ended" not in episode.message


def test_where_efficiency_needs_all_it_counts_from_the_last_delivery_on() -> None:
    episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10, efficiency_needs_all=True)
    scores = []
    for action in "RRR":
        fly(episode, action)
        scores.append(episode.score)
    assert scores == [0.40, 0.40, 0.9325]  # 0.8 + 0.2 * (0.5 * 7/10 + 0.5 * 5/8)


def test_efficiency_is_75_parts_parcels_15_battery_and_10_steps() -> None:
    episode = toy_episode(["@0.1", "...."], max_steps=8, battery_capacity=10)
    fly(episode, "R")
    assert episode.efficiency == pytest.approx(75 / 2 + 15 * 9 / 10 + 10 * 7 / 8)
    assert episode.score_parts == pytest.approx((0.8 / 2, 0.1 * 9 / 10, 0.1 * 7 / 8))


@pytest.mark.feature("L2")
@pytest.mark.parametrize(
    ("drawing", "actions", "changes", "values"),
    [
        (["...@", "....", "0...", "....", "...."], "D", {}, [3 / 4, 1 / 5, 0.9, 0, 2 / 5]),
        # With nothing left it repeats the drone's own position.
        (["....", "@0.."], "R", {}, [0.25, 0.5, 0.9, 0.25, 0.5]),
        # The steps left, where the battery does not tell the time.
        (["@..0", "...."], "R", {"max_steps": 4, "battery_capacity": 8}, [0.25, 0, 7 / 8, 0.75, 0, 0.75]),
    ],
)
def test_telemetry(drawing: list[str], actions: str, changes: dict[str, Any], values: list[float]) -> None:
    episode = toy_episode(drawing, **changes)
    fly(episode, actions)
    assert episode.observation()["telemetry"].tolist() == pytest.approx(values)
