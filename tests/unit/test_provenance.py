"""Names of pilots in sessions and records."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.server.pilots import Provenance

WORDS = st.sampled_from(
    ["human", "greedy", " with values", " with undo", " and undo", " from step ", "07", "7", " of ", " (Ada)", ")"]
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(WORDS, max_size=12).map("".join) | st.text())
def test_whatever_a_record_names_stays_as_it_is(agent: str) -> None:
    assert str(Provenance.parse(agent)) == agent


@pytest.mark.parametrize(
    ("pilot", "step", "of", "said"),
    [
        ("human", 20, "pathqnet", "human from step 20 of pathqnet"),
        ("greedy", 3, "a model with values", "greedy from step 3 of a model with values"),
        ("human", 0, "pathqnet", "human"),
        ("human", 0, "human from step 20 of pathqnet", "human"),
        ("human", 0, "human with values", "human with values"),
        ("human", 4, "human (Ada) with undo from step 3 of greedy", "human (Ada) with undo from step 3 of greedy"),
        ("greedy", 4, "human (Ada)", "greedy from step 4 of human (Ada)"),
        # A pilot may continue its own flight.
        ("human", 5, "human", "human with undo"),
        ("human", 5, "human with values", "human with values and undo"),
        ("greedy", 5, "greedy", "greedy"),
        ("human", 30, "human with values from step 20 of greedy", "human with values and undo from step 20 of greedy"),
        # The fork ignores all steps after it.
        ("human", 20, "human with undo from step 20 of greedy", "human from step 20 of greedy"),
        ("greedy", 9, "human from step 20 of greedy from step 10 of random", "greedy from step 9 of random"),
        ("optimal", 30, "human from step 20 of greedy", "optimal from step 30 of human from step 20 of greedy"),
    ],
)
def test_a_fork_names_who_flew_each_part(pilot: str, step: int, of: str, said: str) -> None:
    assert str(Provenance.of_fork(pilot, step, of)) == said
