"""Drain and charge, by hand."""

from drone_env.core.actions import Event, Outcome
from drone_env.core.cells import Cell
from tests.toy import fly, toy_episode


class TestBattery:
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

    def test_wait_on_a_pad_charges_without_drain_up_to_the_capacity(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=3)
        fly(episode, "RDUWW")
        assert [step.battery for step in episode.path] == [9, 8, 7, 10, 10]
        assert (episode.event, episode.steps) == (Event.WAIT, 5)

    def test_only_wait_charges(self) -> None:
        episode = toy_episode(["@P0", "..."], charge_rate=3)
        fly(episode, "RU")
        assert (episode.event, episode.battery_units) == (Event.WALL, 8)

    def test_pad_without_charge_rate_drains_like_road(self) -> None:
        episode = toy_episode(["@P0", "..."])
        fly(episode, "RW")
        assert episode.battery_units == 8
