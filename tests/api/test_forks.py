"""Forks of flights on the page, and help for who flies by hand: what is shown, and who is said to have flown."""

from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.episode import Episode
from drone_env.models import DIRECTIONS, Direction
from tests.api.live_page import directions, flown, open_page

ADA = {"pilot": "human", "person": "Ada"}


def fork(of: Episode, step: int, by: str, *moves: Direction) -> dict[str, Any]:
    return {"actions": [*directions(of)[:step], *moves], "step": step, "of": {"pilot": by}}


def test_a_fork_is_kept_as_what_it_is_and_counted_apart(client: TestClient) -> None:
    before = flown("easy", "greedy")
    waits = before.task.max_steps - 4
    with open_page(client) as page:
        _, shown = page.start("greedy", "human", fork=fork(before, 3, "greedy", "WAIT"))
        assert shown["opening"]["pilot"] == "human"
        for _ in range(waits):
            page.send("fly", flight=1, direction="WAIT")
        ended = page.until("ended")
        assert (ended["flight"], ended["episode"]["agent"]) == (1, "human from step 3 of greedy")
    record = client.get(f"/episodes/{ended['episode']['id']}").json()
    assert record["actions"] == [*directions(before)[:3], *["WAIT"] * (waits + 1)]
    replayed = client.post("/replay", json=record).json()["opening"]
    assert (replayed["pilot"], replayed["by"], replayed["forked_at"]) == ("human", "human from step 3 of greedy", 3)
    assert client.get("/episodes?agent=human").json()["episodes"] == []


def test_a_person_goes_on_with_a_flight_of_his_own_as_he_left_it(client: TestClient) -> None:
    way = flown("easy", "random", 4)
    left = {"actions": directions(way), "step": 0, "of": {"pilot": "human", "values_used": True}}
    with open_page(client) as page:
        own, beside = page.start("human", "greedy", fork=left)
        assert [frame["action"] for frame in own["frames"]] == [None, *directions(way)]
        assert [frame["action"] for frame in beside["frames"][1:]] == directions(flown("easy", "greedy", 4))
        assert (own["opening"]["by"], own["opening"]["forked_at"]) == ("human with values", None)
        page.send("undo", flight=0)
        undone = page.until("undone")
        assert (undone["step"], undone["by"]) == (3, "human with values and undo")


def test_an_agent_goes_on_from_where_another_was_and_comes_back_there(client: TestClient) -> None:
    pilot, before = "greedy", flown("hard", "random")
    expected = directions(flown("hard", pilot, start=flown("hard", "random", 12)))
    with open_page(client) as page:
        (shown,) = page.start(pilot, task="hard", fork=fork(before, 12, "random"))
        session = shown["opening"]["session"]
        for _ in range(3):
            page.send("step")
            page.until("frames")
    with open_page(client) as page:
        page.send("attach", sessions=[session])
        (again,) = page.until("flights")["flights"]
        assert again["opening"]["by"] == f"{pilot} from step 12 of random"
        page.send("play", speed=60)
        assert page.until("playing")["playing"]
        frames = [*again["frames"][1:], *page.flight()[0]]
    assert [frame["action"] for frame in frames] == expected
    # Its moves are known to be its own where a link has brought them.
    with open_page(client) as page:
        brought: dict[str, Any] = {"actions": expected[:20], "step": 12, "of": {"pilot": "random"}}
        assert len(page.start(pilot, task="hard", fork=brought)[0]["frames"]) == 21
        wrong = next(direction for direction in DIRECTIONS if direction != expected[14])
        page.send("start", task="hard", seed=7, pilots=[pilot], fork={**brought, "actions": [*expected[:14], wrong]})
        assert "step 15 of the fork" in page.until("error")["detail"]


@pytest.mark.parametrize("live", [True, False], ids=["flown here", "only linked"])
def test_flights_that_have_ended_are_kept_once_however_often_their_link_is_opened(
    client: TestClient, live: bool
) -> None:
    before = flown("easy", "greedy")
    rest = before.task.max_steps - 3
    shown: set[str] = set()
    if live:
        with open_page(client) as page:
            page.start("greedy", "human", fork=fork(before, 3, "greedy"), name="Ada")
            # The link says neither of these, and no name.
            page.send("help", flight=1)
            page.send("fly", flight=1, direction="UP")
            page.send("undo", flight=1)
            for _ in range(rest):
                page.send("fly", flight=1, direction="WAIT")
                page.send("step")
            shown = {page.until("ended")["episode"]["agent"] for _ in range(2)}
            assert shown == {"greedy", "human (Ada) with values and undo from step 3 of greedy"}
    whole = fork(before, 3, "greedy", *["WAIT"] * rest)  # type: ignore[list-item]
    for _ in range(2):
        with open_page(client) as page:
            views = page.start("greedy", "human", fork=whole, name="Ben")
            assert all(view["frames"][-1]["done"] for view in views)
            ended = {page.until("ended")["episode"]["agent"] for _ in range(2)}
            assert ended == {view["opening"]["by"] for view in views}
            assert ended == (shown or ended)
    assert len(client.get("/episodes").json()["episodes"]) == 2


def test_a_race_that_is_over_is_opened_to_all_its_ends_and_stays_the_flight_of_who_flew_it(client: TestClient) -> None:
    whole = {"actions": ["WAIT"] * 60, "step": 0, "of": {**ADA, "undo_used": True}}
    with open_page(client) as page:
        own, greedy = page.start("human", "greedy", fork=whole, step=60, name="Bob")
        assert own["frames"][-1]["done"]
        assert own["opening"]["by"] == "human (Ada) with undo"
        assert greedy["frames"][-1]["done"]
        # A flight that goes on is that of who goes on; the others have flown as far as the link says.
        left = {"actions": ["WAIT"], "step": 0, "of": ADA}
        own, greedy = page.start("human", "greedy", fork=left, step=3, name="Bob")
        assert own["opening"]["by"] == "human (Bob)"
        assert [len(flight["frames"]) - 1 for flight in (own, greedy)] == [1, 3]


def test_a_person_in_flight_is_shown_values_once_asked_for_and_the_record_says_so(client: TestClient) -> None:
    with open_page(client) as page:
        (shown,) = page.start("human")
        header = {"X-Session-Id": shown["opening"]["session"]}
        kept_back = ("q_values", "value", "regret")
        assert [shown["frames"][0][name] for name in kept_back] == [None] * 3
        page.send("fly", direction="UP")
        frame = page.until("frames")["frames"][0]["frame"]
        assert [frame[name] for name in kept_back] == [None] * 3
        page.send("help", flight=0)
        helped = page.until("helped")
        assert (helped["flight"], helped["by"], helped["frame"]["step"]) == (0, "human with values", 1)
        assert helped["frame"]["q_values"] == client.post("/predict", headers=header).json()["q_values"]
        assert len(page.until("values")["values"]) == 2
        page.send("fly", direction="WAIT")
        assert page.until("frames")["frames"][0]["frame"]["q_values"]
        assert len(page.until("values")["values"]) == 3
    with open_page(client) as page:
        page.send("attach", sessions=[header["X-Session-Id"]])
        (again,) = page.until("flights")["flights"]
        assert (again["opening"]["by"], again["opening"]["pilot"]) == ("human with values", "human")
        assert all(frame["q_values"] for frame in again["frames"])


def test_a_person_takes_steps_back_and_the_record_says_so(client: TestClient) -> None:
    before = flown("easy", "greedy")
    with open_page(client) as page:
        (shown,) = page.start("human", fork=fork(before, 2, "greedy"))
        header = {"X-Session-Id": shown["opening"]["session"]}
        for direction in ("WAIT", "WAIT", "UP"):
            page.send("fly", direction=direction)
            page.until("frames")
        for step in (4, 3, 2):
            page.send("undo", flight=0)
            by = "human with undo from step 2 of greedy"
            undone = {"flight": 0, "step": step, "by": by, "undo_used": True, "values_used": False}
            assert page.until("undone") == {"type": "undone", **undone}
            assert client.get("/state", headers=header).json()["step_count"] == step
        page.send("undo", flight=0)
        assert page.until("error")["code"] == "wrong_moment"
        page.send("fly", direction="DOWN")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 3
        for _ in range(57):
            page.send("fly", direction="WAIT")
        episode = page.until("ended")["episode"]
        assert episode["agent"] == by
    record = client.get(f"/episodes/{episode['id']}").json()
    assert record["actions"] == [*directions(before)[:2], "DOWN", *["WAIT"] * 57]
