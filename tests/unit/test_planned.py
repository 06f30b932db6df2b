"""The agents without learning: the greedy one, nearest neighbour with recharging, and beam search."""

from typing import Any

import pytest

from drone_env.agents import make_agent
from drone_env.core.actions import Action, Event
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.evaluate import evaluate
from tests.toy import fly, toy_episode

RULES: dict[str, Any] = {
    "drain": ((Cell.BUILDING, 3),),
    "impassable": frozenset({Cell.OBSTACLE}),
    "efficiency_needs_all": True,
}


def flight(agent: str, street: str, battery: int, actions: str = "", max_steps: int = 40) -> str:
    """The actions of an agent on a street, after those of somebody else, up to the end. One WAIT fills the battery."""
    numbers: dict[str, Any] = {"battery_capacity": battery, "charge_rate": battery, "max_steps": max_steps}
    episode = toy_episode([street, "O" * len(street)], **RULES, **numbers)
    pilot = make_agent(agent, episode.task)
    pilot.reset(0)
    fly(episode, actions)
    flown = ""
    while not episode.ended:
        flown += Action(pilot.act(episode.observation())).name[0]
        fly(episode, flown[-1])
    return flown


@pytest.mark.parametrize(
    ("street", "battery", "flown"),
    [
        # The nearest parcel first; a pad is in range of it, and the last parcel needs none.
        ("1..@0P", 7, "RLLLL"),
        # The nearest parcel is in range, but no pad would be from there.
        ("@..P..0...1", 8, "RRRWRRRRRRR"),
        # The last parcel may take the last unit.
        ("@...0P", 4, "RRRR"),
        # One pad leads on to the next one.
        ("@..P...P...0", 5, "RRRWRRRRWRRRR"),
        # The nearest pad leads nowhere, the other one to the parcel.
        ("P@...P....0", 5, "RRRRWRRRRR"),
        # Buildings cost 3: the parcel behind them is not the nearest.
        ("0BB@..1", 30, "RRRLLLLLL"),
        # On its way to a pad it delivers what it flies over.
        ("@.0.P...1", 6, "RRRRWRRRR"),
        # No pad is in range: it delivers what it still can.
        ("0.@...1......P", 3, "LLW"),
        # Nothing is in range.
        ("@O0", 3, "WWW"),
    ],
)
def test_nearest_fills_up_only_where_it_must(street: str, battery: int, flown: str) -> None:
    assert flight("nearest", street, battery) == flown


def test_nearest_plans_again_from_where_it_did_not_mean_to_be() -> None:
    assert flight("nearest", "@.P......0", 8) == "RRWRRRRRRR"
    assert flight("nearest", "@.P......0", 8, actions="RRR") == "LWRRRRRRR"


def test_beam_search_finds_the_order_that_nearest_misses() -> None:
    # The nearest parcel first costs two steps more in all.
    assert flight("nearest", "1...0@..2", 40) == "LLLLLRRRRRRRR"
    assert flight("beam:1", "1...0@..2", 40) == "RRRLLLLLLLL"
    # In the time for one parcel on the left, two on the right can be delivered.
    assert flight("nearest", "0..@...12", 40, max_steps=5) == "LLLWW"
    assert flight("beam", "0..@...12", 40, max_steps=5) == "RRRRR"


@pytest.mark.parametrize(
    ("agent", "task", "share"),
    [
        ("nearest", "skyline_hard", 0.9470),
        ("beam:4", "skyline_hard", 0.9857),
        ("beam", "city_small", 0.9987),
    ],
)
def test_share_of_the_optimum_on_40_maps(agent: str, task: str, share: float) -> None:
    flown = evaluate(agent, task, "validation", 40)
    assert flown.scores.sum() / flown.optimal_scores.sum() == pytest.approx(share, abs=1e-4)


def test_the_width_is_part_of_the_name() -> None:
    task = get_task("easy")
    assert make_agent("beam:7", task).config == {"agent": "beam", "version": 1, "width": 7}
    for name in ("beam:", "beam:wide", "beam:0", "beam:100001"):
        with pytest.raises((UnknownNameError, InvalidValueError), match="beam"):
            make_agent(name, task)


def test_more_parcels_or_battery_than_the_task_has_are_refused() -> None:
    task = get_task("skyline_easy")
    shown = Episode(task, seed=0).observation()
    parcels, battery = shown["grid"].copy(), shown["telemetry"].copy()
    parcels[parcels == Cell.ROAD] = Cell.DELIVERY
    battery[2] = 1.5
    for grid, telemetry in ((parcels, shown["telemetry"]), (shown["grid"], battery)):
        with pytest.raises(InvalidValueError, match=r"an observation .*'skyline_easy'"):
            make_agent("nearest", task).act({"grid": grid, "telemetry": telemetry})


@pytest.mark.parametrize(
    ("drawing", "units", "path"),
    [
        # Over the building costs units + 1, round it 4; equally much battery: fewer steps.
        (["...", "@B0"], 4, "URRD"),
        (["...", "@B0"], 3, "RR"),
        # The parcel that is two steps away costs 10; the one that is five away costs 5.
        (["BBBBBB", "0B@...", "BBBBB1"], 9, "RRRD"),
        # Of equally cheap ones the first in reading order.
        (["..1.B", ".....", "0.@.2"], 9, "UU"),
        # Impassable obstacles are flown round.
        (["@O0", ".O.", "..."], 1, "DDRRUU"),
        # Walled in there is nothing to fly to.
        (["@O0", "OO.", "..."], 1, "WWW"),
    ],
)
def test_flies_the_cheapest_way(drawing: list[str], units: int, path: str) -> None:
    drains = {"drain": ((Cell.BUILDING, units),), "impassable": frozenset({Cell.OBSTACLE})}
    episode = toy_episode(drawing, max_steps=40, **drains)
    agent = make_agent("greedy", episode.task)
    agent.reset(0)
    flown = ""
    while len(flown) < len(path):
        flown += Action(agent.act(episode.observation())).name[0]
        fly(episode, flown[-1])
    assert flown == path
    assert episode.event == (Event.WAIT if "W" in path else Event.DELIVERY)
