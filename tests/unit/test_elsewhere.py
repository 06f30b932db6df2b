"""A flight with its drone elsewhere, and the range of its battery: beside steps by the rules."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tables import BATTERY, EVENT, OUTCOME, STEPS
from drone_env.planning.elsewhere import UNREACHED, Places, battery_range, charging_pads, places_of
from drone_env.planning.from_observation import episode_from_fields
from drone_env.planning.optimal import solver_of
from tests.toy import fly, toy_episode

TOUR = "RRDDLLDRRRUUUURDDLLLUURRDDDLLUURRRDD"
"""Goes round and round: over parcels, terrain and walls."""


def ground_of(episode: Episode) -> npt.NDArray[np.uint8]:
    """The grid without the drone, uint8[cells]."""
    ground = episode.grid().ravel()
    ground[episode.cell] = episode.under
    return ground


def place(places: Places, cell: int) -> int:
    return places.cells.tolist().index(cell)


def assert_places_follow_steps(flight: Episode) -> None:
    """What a step leads to is what stands at that place before it, but for what the step itself changes."""
    before = places_of(flight)
    here = place(before, flight.cell)
    assert np.array_equal(before.grids[here], flight.grid().ravel())
    assert np.array_equal(before.telemetry[here], flight.observation()["telemetry"])
    for action in Action:
        after = flight.copy().fly([action])
        there = place(before, after.cell)
        if after.battery_units == 0:
            continue
        expected = np.frombuffer(after.get_state().numbers, np.uint16).copy()
        for number in (BATTERY, STEPS, EVENT):
            expected[number] = before.states[there, number]
        assert np.array_equal(before.states[there], expected)
        assert np.array_equal(before.grids[there], after.grid().ravel())


@pytest.mark.parametrize("task", ["easy", "hard", "skyline_easy", "skyline_hard"])
def test_a_place_looks_as_if_the_drone_had_just_flown_there(task: str) -> None:
    flight = Episode(task, seed=7)
    for letter in TOUR:
        assert_places_follow_steps(flight)
        fly(flight, letter)
        if flight.ended:
            break


def test_where_the_last_parcel_waits_the_flight_is_over_and_the_drone_cannot_be_where_it_cannot_enter() -> None:
    places = places_of(toy_episode(["@O0", "B.T"], impassable=frozenset({Cell.OBSTACLE})))
    assert places.cells.tolist() == [0, 2, 3, 4, 5]
    assert places.flying.tolist() == [True, False, True, True, True]
    assert places.states[:, OUTCOME].tolist() == [0, 1, 0, 0, 0]


@pytest.mark.parametrize("task", ["medium", "skyline_easy"])
def test_the_value_of_a_place_is_that_of_an_episode_that_begins_there(task: str) -> None:
    flight = Episode(task, seed=3).fly([Action.RIGHT, Action.DOWN, Action.DOWN])
    solver, places = solver_of(Episode(task, seed=3)), places_of(flight)
    q_values = solver.q_values_of(places.grids[places.flying], places.states[places.flying])
    for cell, values in list(zip(places.cells[places.flying].tolist(), q_values, strict=True))[::7]:
        parcels = [
            (at, delivered or at == cell) for x, y, delivered in flight.parcels for at in [y * flight.task.width + x]
        ]
        ground = ground_of(flight)
        if ground[cell] == Cell.DELIVERY:
            ground[cell] = Cell.DELIVERED
        begun = episode_from_fields(flight.task, ground, cell, flight.battery_units, flight.steps, parcels)
        assert values.tolist() == solver_of(begun).q_values(begun).tolist()


def slow_range(episode: Episode, cell: int, units: int) -> list[int]:
    """The same by flying every move from every (cell, units) that was reached, step by step."""
    task, ground = episode.task, ground_of(episode)
    parcels = [y * task.width + x for x, y, _ in episode.parcels]
    most = [UNREACHED] * len(ground)
    most[cell] = units
    seen, reached = {(cell, units)}, {(cell, units)}
    for steps in range(episode.steps, task.max_steps):
        left = {state for state in reached if state[1] > 0}
        reached = set[tuple[int, int]]()
        for at, battery in left:
            # Of all parcels only that below the drone has been delivered, so that the next is never the last.
            below = ground.copy()
            if below[at] == Cell.DELIVERY:
                below[at] = Cell.DELIVERED
            begun = episode_from_fields(task, below, at, battery, steps, [(parcel, parcel == at) for parcel in parcels])
            for move in (Action.UP, Action.DOWN, Action.LEFT, Action.RIGHT):
                flown = begun.copy().fly([move])
                reached.add((flown.cell, flown.battery_units))
                most[flown.cell] = max(most[flown.cell], flown.battery_units)
        reached -= seen
        seen |= reached
    return most


@pytest.mark.parametrize(("task", "steps"), [("skyline_easy", 0), ("skyline_easy", 56), ("medium", 94)])
def test_the_range_is_what_flying_every_move_finds(task: str, steps: int) -> None:
    for seed in (1, 2):
        flight = Episode(task, seed=seed)
        waited = episode_from_fields(
            flight.task,
            ground_of(flight),
            flight.cell,
            flight.battery_units - 4,
            steps,
            [(y * flight.task.width + x, False) for x, y, _ in flight.parcels],
        )
        assert battery_range(waited, waited.cell, 7).tolist() == slow_range(waited, waited.cell, 7)
        for pad in charging_pads(waited):
            full = waited.task.battery_capacity
            assert battery_range(waited, pad, full).tolist() == slow_range(waited, pad, full)


def test_the_range_on_a_map_where_it_is_obvious() -> None:
    drains: dict[str, Any] = {"drain": ((Cell.BUILDING, 3),), "impassable": frozenset({Cell.OBSTACLE})}
    # Over the building it would not last, and on its last unit it gets there and no further.
    street = toy_episode(["@0B.1", "OOOOO"], battery_capacity=4, **drains)
    assert battery_range(street, street.cell, 4).tolist() == [4, 3, 0, -1, -1, *[-1] * 5]
    # Round the building it is dearer than over it, and with few steps left there is no way round.
    around = toy_episode(["@B.", "...", "10."], battery_capacity=9, drain=((Cell.BUILDING, 4),))
    assert battery_range(around, around.cell, 9).tolist() == [9, 5, 5, 8, 7, 6, 7, 6, 5]
    assert charging_pads(around) == []
    late = toy_episode(["@B.", "...", "10."], battery_capacity=9, drain=((Cell.BUILDING, 4),), max_steps=2)
    assert battery_range(late, late.cell, 9).tolist() == [9, 5, 4, 8, 7, -1, 7, -1, -1]


def test_a_pad_that_charges_nothing_has_no_range_of_its_own() -> None:
    assert charging_pads(toy_episode(["@P", "0P"], charge_rate=2)) == [1, 3]
    assert charging_pads(toy_episode(["@P", "0P"])) == []
