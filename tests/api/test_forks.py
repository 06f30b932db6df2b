"""Forks of flights on the page, and help for who flies by hand: what is shown, and who is said to have flown."""

from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.episode import Episode
from drone_env.models import Direction
from tests.api.flying import ByHand, directions, flown, label, start

ADA = {"pilot": "human", "person": "Ada"}


def fork(of: Episode, step: int, by: str, *moves: Direction) -> dict[str, Any]:
    return {"actions": [*directions(of)[:step], *moves], "step": step, "of": {"pilot": by}}


def test_a_fork_is_kept_as_what_it_is_and_counted_apart(client: TestClient) -> None:
    before = flown("easy", "greedy")
    waits = before.task.max_steps - 4
    _, shown = start(client, "greedy", "human", fork=fork(before, 3, "greedy", "WAIT"))
    assert shown["opening"]["pilot"] == "human"
    ended = ByHand(client, shown).change(*["WAIT"] * waits)
    record = client.get(f"/episodes/{ended['episode']}").json()
    assert record["agent"] == "human from step 3 of greedy"
    assert record["actions"] == [*directions(before)[:3], *["WAIT"] * (waits + 1)]
    replayed = client.post("/replay", json=record).json()
    assert label(replayed) == "human from step 3 of greedy"
    assert client.get("/episodes?agent=human").json()["episodes"] == []


def test_a_person_goes_on_with_a_flight_of_his_own_as_he_left_it(client: TestClient) -> None:
    way = flown("easy", "random", 4)
    left = {"actions": directions(way), "step": 0, "of": {"pilot": "human", "values_used": True}}
    own, beside = start(client, "human", "greedy", fork=left)
    assert [frame["action"] for frame in own["frames"]] == [None, *directions(way)]
    assert [frame["action"] for frame in beside["frames"][1:]] == directions(flown("easy", "greedy"))
    assert label(own) == "human with values"
    undone = ByHand(client, own).change("UNDO")
    assert (undone["frame"]["step"], undone["values_used"], undone["undo_used"]) == (3, True, True)


@pytest.mark.parametrize("by_hand", [True, False], ids=["flown here", "only linked"])
def test_flights_that_have_ended_are_kept_once_however_often_their_link_is_opened(
    client: TestClient, by_hand: bool
) -> None:
    before = flown("easy", "greedy")
    rest = before.task.max_steps - 3
    if by_hand:
        _, shown = start(client, "greedy", "human", fork=fork(before, 3, "greedy"), name="Ada")
        # The link says neither of these, and no name.
        ended = ByHand(client, shown).change("VALUES", "UP", "UNDO", *["WAIT"] * rest)
        agent = client.get(f"/episodes/{ended['episode']}").json()["agent"]
        assert agent == "human (Ada) with values and undo from step 3 of greedy"
    whole = fork(before, 3, "greedy", *["WAIT"] * rest)  # type: ignore[list-item]
    for _ in range(2):
        views = start(client, "greedy", "human", fork=whole, name="Ben")
        assert all(view["frames"][-1]["done"] for view in views)
        stored = {row["id"]: row["agent"] for row in client.get("/episodes").json()["episodes"]}
        assert stored == {view["episode"]: label(view) for view in views}


def test_a_race_that_is_over_stays_the_flight_of_who_flew_it(client: TestClient) -> None:
    whole = {"actions": ["WAIT"] * 60, "step": 0, "of": {**ADA, "undo_used": True}}
    own, _ = start(client, "human", "greedy", fork=whole, name="Bob")
    assert (label(own), own["version"]) == ("human (Ada) with undo", None)
    # A flight that goes on is that of who goes on.
    left = {"actions": ["WAIT"], "step": 0, "of": ADA}
    own, _ = start(client, "human", "greedy", fork=left, name="Bob")
    assert (label(own), len(own["frames"])) == ("human (Bob)", 2)


def test_a_person_in_flight_is_shown_values_once_asked_for_and_the_record_says_so(client: TestClient) -> None:
    (shown,) = start(client, "human")
    flight = ByHand(client, shown)
    assert shown["frames"][0]["q_values"] is None
    assert flight.change("UP")["frame"]["q_values"] is None
    helped = flight.change("VALUES")
    assert (helped["values_used"], helped["undo_used"], helped["frame"]["step"]) == (True, False, 1)
    assert helped["frame"]["q_values"] == client.post("/predict", headers=flight.header).json()["q_values"]
    assert flight.change("WAIT")["frame"]["q_values"]


def test_a_person_takes_steps_back_and_the_record_says_so(client: TestClient) -> None:
    before = flown("easy", "greedy")
    (shown,) = start(client, "human", fork=fork(before, 2, "greedy"))
    flight = ByHand(client, shown)
    flight.change("WAIT", "WAIT", "UP")
    for step in (4, 3, 2):
        undone = flight.change("UNDO")
        assert (undone["frame"]["step"], undone["undo_used"], undone["values_used"]) == (step, True, False)
        assert client.get("/state", headers=flight.header).json()["step_count"] == step
    assert undone["frame"] == {**shown["frames"][2], "q_values": None}
    assert flight.change("UNDO")["code"] == "wrong_moment"
    ended = flight.change("DOWN", *["WAIT"] * 57)
    record = client.get(f"/episodes/{ended['episode']}").json()
    assert record["agent"] == "human with undo from step 2 of greedy"
    assert record["actions"] == [*directions(before)[:2], "DOWN", *["WAIT"] * 57]
