"""The agent that flies to the nearest target."""

import pytest

from drone_env.agents import make_agent
from drone_env.core.actions import Action, Event
from drone_env.core.cells import Cell
from tests.toy import fly, toy_episode


@pytest.mark.parametrize(
    ("drawing", "units", "path"),
    [
        # Over the building costs units + 1, round it 4.
        (["...", "@B0"], 2, "RR"),
        (["...", "@B0"], 4, "URRD"),
        # Equally much battery: fewer steps.
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
