"""A flight with its drone elsewhere, and the range of its battery: beside steps by the rules."""

from typing import Any

import numpy as np
import pytest

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tables import BATTERY, EVENT, OUTCOME, STEPS
from drone_env.planning.cell_states import battery_range, charging_pads, states_at_cells
from tests.toy import fly, toy_episode

TOUR = "RRDDLLDRRRUUUURDDLLLUURRDDDLLUURRRDD"
"""Goes round and round: over parcels, terrain and walls."""


def assert_places_follow_steps(flight: Episode) -> None:
    """What a step leads to is what stands at that place before it, but for what the step itself changes."""
    before = states_at_cells(flight)
    here = before.cells.tolist().index(flight.cell)
    assert np.array_equal(before.grids[here], flight.grid().ravel())
    assert np.array_equal(before.telemetry[here], flight.observation()["telemetry"])
    for action in Action:
        after = flight.copy().fly([action])
        there = before.cells.tolist().index(after.cell)
        if after.battery_units == 0:
            continue
        expected = np.frombuffer(after.get_state().numbers, np.uint16).copy()
        for number in (BATTERY, STEPS, EVENT):
            expected[number] = before.states[there, number]
        assert np.array_equal(before.states[there], expected)
        assert np.array_equal(before.grids[there], after.grid().ravel())


@pytest.mark.parametrize("task", ["hard", "skyline_easy"])
def test_a_place_looks_as_if_the_drone_had_just_flown_there(task: str) -> None:
    flight = Episode(task, seed=7)
    for letter in TOUR:
        assert_places_follow_steps(flight)
        fly(flight, letter)
        if flight.ended:
            break


def test_where_the_last_parcel_waits_the_flight_is_over_and_the_drone_cannot_be_where_it_cannot_enter() -> None:
    places = states_at_cells(toy_episode(["@O0", "B.T"], impassable=frozenset({Cell.OBSTACLE})))
    assert places.cells.tolist() == [0, 2, 3, 4, 5]
    assert places.flying.tolist() == [True, False, True, True, True]
    assert places.states[:, OUTCOME].tolist() == [0, 1, 0, 0, 0]


def test_the_range_on_a_map_where_it_is_obvious() -> None:
    drains: dict[str, Any] = {"drain": ((Cell.BUILDING, 3),), "impassable": frozenset({Cell.OBSTACLE})}
    # Over the building it would not last, and on its last unit it gets there and no further.
    street = toy_episode(["@0B.1", "OOOOO"], battery_capacity=4, **drains)
    assert battery_range(street, street.cell, 4).tolist() == [4, 3, 0, -1, -1, *[-1] * 5]
    # A move may drain more than the battery has, but nothing lies behind.
    assert battery_range(street, street.cell, 2).tolist() == [2, 1, 0, -1, -1, *[-1] * 5]
    # Round the building it is cheaper than over it.
    around = toy_episode(["@B.", "...", "10."], battery_capacity=9, drain=((Cell.BUILDING, 4),))
    assert battery_range(around, around.cell, 9).tolist() == [9, 5, 5, 8, 7, 6, 7, 6, 5]
    assert charging_pads(around) == charging_pads(toy_episode(["@P", "0P"])) == []
    assert charging_pads(toy_episode(["@P", "0P"], charge_rate=2)) == [1, 3]
