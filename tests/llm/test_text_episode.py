"""`TextEpisode`: a flight as messages and answers."""

import pytest

from drone_env.errors import EpisodeError
from drone_env.llm import TextEpisode
from drone_env.llm.answers import Answer
from drone_env.planning.optimal import solve


def test_a_flight_by_text() -> None:
    # Map 14 of easy by hand.
    flight = TextEpisode("easy", 14, reward_profile="tiered")
    system, user = flight.messages
    assert (system["role"], user["role"]) == ("system", "user")
    again = flight.answer("Let us go left!")
    assert again[:2] == [system, user]
    assert again[2] == {"role": "assistant", "content": "Let us go left!"}
    assert "the answer is not one action" in again[3]["content"]
    assert flight.episode.rewards == []
    assert "Position: (5, 3)" in flight.answer("LEFT")[1]["content"]
    assert (flight.score, flight.success) == (0.01, False)  # as if it waited to the end
    flight.answer("UP")
    assert flight.answer("UP") == flight.messages == []
    assert (flight.turns, [error for *_, error in flight.flown]) == (["repaired", "ok", "ok"], [None, None, None])
    assert (flight.score, flight.success, flight.episode.rewards) == (0.99, True, [0.15, 0.15, 0.99])
    assert flight.regret == solve("easy", 14).score - 0.99
    with pytest.raises(EpisodeError, match="the flight is over"):
        flight.answer("UP")


def test_unusable_answers_are_waits_and_thoughts_and_routes_are_read() -> None:
    flight = TextEpisode("easy", 14)
    for text in ("Hm." * 1000, "NORTH"):
        flight.answer(text)
    assert (flight.turns, [error for *_, error in flight.flown], flight.episode.actions) == (
        ["illegal"],
        ["illegal"],
        [4],
    )
    # The model sees the beginning of a long answer.
    (_, _, quoted, _) = TextEpisode("easy", 14).answer(Answer(text="Hm." * 1000, finish_reason="length"))
    assert quoted["content"] == ("Hm." * 1000)[:2000]
    assert TextEpisode("easy", 14).answer(" \n")[2] == {"role": "assistant", "content": "(no text)"}
    aloud = TextEpisode("easy", 14, "think")
    aloud.answer("Not every ACTION: brings it nearer.\n**ACTION: LEFT**")
    assert (aloud.turns, aloud.episode.actions) == (["ok"], [2])
    route = TextEpisode("easy", 14, "plan")
    assert route.answer("LEFT, UP") == []
    assert (route.episode.ended, route.turns, route.score) == (False, ["ok"], 0.01)
