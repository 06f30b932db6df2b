"""Who flew a flight: the label, and what a fork means."""

import json
from typing import Any

import pytest
from pydantic import ValidationError

from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.flights.provenance import Provenance
from drone_env.flights.record import EpisodeRecord, record_of

HELP: dict[str, Any] = {"values": {"values_used": True}, "undo": {"undo_used": True}}


def of(pilot: str, *help_used: str, person: str | None = None, at: int = 0, parent: Provenance | None = None) -> Any:
    fields = {"pilot": pilot, "person": person, **{k: v for name in help_used for k, v in HELP[name].items()}}
    before = None if parent is None else {**dict(parent), "step": at}
    return Provenance.model_validate({**fields, "parent": before})


GREEDY = of("greedy")
FORK = of("human", at=20, parent=GREEDY)


@pytest.mark.parametrize(
    ("pilot", "step", "before", "after", "label"),
    [
        ("human", 20, GREEDY, FORK, "human from step 20 of greedy"),
        ("greedy", 3, of("a model with values"), None, "greedy from step 3 of a model with values"),
        ("human", 0, FORK, of("human"), "human"),
        ("human", 0, of("human", "values"), of("human", "values"), "human with values"),
        (
            "human",
            4,
            of("human", person="Ada", at=3, parent=GREEDY),
            None,
            "human (Ada) with undo from step 3 of greedy",
        ),
        # A pilot may continue its own flight.
        ("human", 5, of("human"), of("human", "undo"), "human with undo"),
        ("greedy", 5, GREEDY, GREEDY, "greedy"),
        # The fork ignores all steps after it.
        ("human", 20, of("human", "undo", at=20, parent=GREEDY), FORK, "human from step 20 of greedy"),
        ("optimal", 30, FORK, None, "optimal from step 30 of human from step 20 of greedy"),
    ],
)
def test_a_fork_names_who_flew_each_part(
    pilot: str, step: int, before: Provenance, after: Provenance | None, label: str
) -> None:
    fork = before.forked(step, pilot)
    assert fork.label == label
    assert after is None or fork == after
    # It comes back from JSON, and from the record of a flight.
    assert Provenance.model_validate_json(fork.model_dump_json()) == fork
    record = record_of(Episode("easy", "tiered", 7).fly([4]), fork)
    assert record.agent == label
    assert EpisodeRecord.read(record.to_json(), "it") == record
    assert record.provenance == fork
    assert (set(json.loads(record.to_json())) >= {"pilot", "undo_used"}) == (fork != GREEDY and fork != of("human"))


@pytest.mark.parametrize("agent", ["human with values", "human (Ada)", "a from step 2 of b", "x" * 200])
def test_an_agent_of_another_program_is_a_pilot_whatever_its_name(agent: str) -> None:
    record = record_of(Episode("easy", "tiered", 7), agent)
    assert record.provenance == Provenance(pilot=agent)
    with pytest.raises(ValidationError, match="but the other fields say 'human'"):
        EpisodeRecord.model_validate({**dict(record), "agent": agent, "pilot": "human"})


@pytest.mark.parametrize(
    "fields",
    [{"pilot": ""}, {"pilot": "two\u2028lines"}, {"pilot": "x" * 201}, {"person": "a b"}, {"person": "x" * 21}],
)
def test_what_would_not_fit_a_label_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"one printable line of 1 to 200|1 to 20 letters"):
        Provenance.model_validate({"pilot": "human", **fields})
    with pytest.raises(InvalidValueError, match="one printable line of 1 to 200 characters"):
        Provenance(pilot="x" * 200).forked(7, "human")
