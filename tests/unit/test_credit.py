"""Who flew, as sessions and records say it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.server.pilots import PILOTS, Credit, called

NAMES = st.sampled_from(list(PILOTS)) | st.text("ab:/. wvu0", min_size=1, max_size=8).filter(
    lambda name: " with " not in f"{name} " and " from " not in f"{name} "
)


@st.composite
def credits_of(draw: st.DrawFn, before: st.SearchStrategy[Credit] | None = None) -> Credit:
    """Of a flight; of a fork from one of `before`, where that is given."""
    credit = Credit(draw(NAMES), draw(st.booleans()), draw(st.booleans()))
    if before is None:
        return credit
    return credit._replace(forked_at=draw(st.integers(1, 10**6)), of=str(draw(before)))


CREDITS = st.recursive(credits_of(), credits_of, max_leaves=4)
WORDS = st.sampled_from(
    ["human", "greedy", " with values", " with undo", " and undo", " from step ", "07", "7", " of "]
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(CREDITS)
def test_what_is_said_is_read_again(credit: Credit) -> None:
    assert Credit.parse(str(credit)) == credit


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(WORDS, max_size=12).map("".join) | st.text())
def test_whatever_a_record_names_stays_as_it_is(agent: str) -> None:
    assert str(Credit.parse(agent)) == agent


@pytest.mark.parametrize(
    ("pilot", "step", "of", "said"),
    [
        ("human", 20, "pathqnet", "human from step 20 of pathqnet"),
        ("greedy", 3, "a model with values", "greedy from step 3 of a model with values"),
        ("human", 0, "pathqnet", "human"),
        ("human", 0, "human from step 20 of pathqnet", "human"),
        ("human", 0, "human with values", "human with values"),
        # On a flight of its own it goes on.
        ("human", 5, "human", "human with undo"),
        ("human", 5, "human with values", "human with values and undo"),
        ("greedy", 5, "greedy", "greedy"),
        ("human", 30, "human with values from step 20 of greedy", "human with values and undo from step 20 of greedy"),
        # What was flown after the step is of no account.
        ("human", 20, "human with undo from step 20 of greedy", "human from step 20 of greedy"),
        ("greedy", 9, "human from step 20 of greedy from step 10 of random", "greedy from step 9 of random"),
        ("optimal", 30, "human from step 20 of greedy", "optimal from step 30 of human from step 20 of greedy"),
    ],
)
def test_a_fork_names_who_flew_each_part(pilot: str, step: int, of: str, said: str) -> None:
    assert str(Credit.of_fork(pilot, step, of)) == said


@pytest.mark.parametrize(
    ("agent", "words"),
    [
        ("human", "A person"),
        ("human with undo from step 20 of pathqnet", "A person with undo from step 20 of PathQNet"),
        ("me from step 3 of human with values", "me from step 3 of A person with values"),
    ],
)
def test_people_read_names(agent: str, words: str) -> None:
    assert called(agent) == words
