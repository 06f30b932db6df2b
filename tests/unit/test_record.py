"""Records of flights: their versions, what they refuse, and files with many of them."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.flights.provenance import Provenance
from drone_env.flights.record import (
    EpisodeRecord,
    load_record,
    parse_record,
    read_records,
    record_of,
    replay,
    save_record,
)
from tests.unit import stores


def flown(task: str = "easy", profile: str = "tiered", actions: str = "01234") -> EpisodeRecord:
    return record_of(stores.flown(task, 7, actions, profile), "someone")


def changed(record: EpisodeRecord, **fields: Any) -> str:
    return json.dumps(json.loads(record.to_json()) | fields)


def tampered(record: EpisodeRecord, step: int, reward: float) -> EpisodeRecord:
    rewards = list(record.rewards)
    rewards[step] = reward
    return parse_record(changed(record, rewards=rewards), "it")


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("profile", REWARD_PROFILES)
def test_a_record_comes_back_from_its_file_and_flies_to_the_same_bits(task: str, profile: str, tmp_path: Path) -> None:
    record = flown(task, profile)
    save_record(record, tmp_path / "flight.json")
    again = load_record(tmp_path / "flight.json")
    assert again == record
    assert [reward.hex() for reward in replay(again).rewards] == [reward.hex() for reward in again.rewards]


@pytest.mark.parametrize("step", [0, 3, -1])
def test_one_bit_of_one_reward_is_noticed(step: int) -> None:
    record = flown()
    number = range(1, len(record.actions) + 1)[step]
    wrong = tampered(record, step, math.nextafter(record.rewards[step], math.inf))
    with pytest.raises(InvalidValueError, match=rf"reward .* of step {number} where the flight pays [0-9.]+$"):
        replay(wrong)
    assert replay(wrong, "aligned").reward_profile.id == "aligned"


def test_the_sign_of_a_zero_counts() -> None:
    with pytest.raises(InvalidValueError, match=r"reward -0\.0 of step 1 where the flight pays 0\.0"):
        replay(tampered(flown(profile="score"), 0, -0.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"format_version": 2}, "format_version: Input should be 1"),
        ({"rewards": [0.1]}, "1 rewards do not fit 60 actions"),
        ({"actions": ["NORTH"]}, "actions.0: Input should be 'UP', 'DOWN', 'LEFT', 'RIGHT' or 'WAIT'"),
        ({"agent": "two\nlines"}, "agent: an agent's name is one printable line of 1 to 200 characters"),
    ],
)
def test_what_is_no_record_is_refused_by_field(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValueError) as error:
        parse_record(changed(flown(actions="4"), **fields), "flight.json")
    assert str(error.value).startswith("flight.json is not the record of a flight: ")
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("fields", "error", "message"),
    [
        ({"task_version": 9}, UnknownNameError, "allowed: 1"),
        ({"seed": 2**53}, InvalidValueError, "2^53"),
        ({"score": math.nextafter(0.01, 1)}, InvalidValueError, "score 0.010000000000000002 where"),
        ({"actions": ["WAIT"] * 61, "rewards": [0.1] * 61}, InvalidValueError, "ends after 60 steps"),
    ],
)
def test_what_cannot_have_been_flown_is_refused(fields: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error) as raised:
        replay(parse_record(changed(flown(actions="4"), **fields), "it"))
    assert message in str(raised.value)


def test_the_record_in_the_manual_is_one() -> None:
    manual = (Path(__file__).parents[2] / "docs" / "episodes.md").read_text(encoding="utf-8")
    record = parse_record(manual.split("```json\n")[1].split("```")[0], "the manual")
    rare = {"terrain", *Provenance.model_fields}
    assert set(EpisodeRecord.model_fields) == {*json.loads(record.to_json()), *rare}
    assert replay(record).success


# JSONL


RECORDS = [flown(actions="0"), flown("medium", "aligned"), flown(actions="4"), flown("skyline_easy")]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    for record in RECORDS:
        save_record(record, tmp_path / "flights.jsonl")
    return tmp_path / "flights.jsonl"


def test_a_cut_last_line_is_an_error_after_the_whole_lines(file: Path) -> None:
    assert list(read_records(file)) == RECORDS
    whole = file.read_bytes()
    start = whole.rindex(b"\n", 0, -1) + 1
    for length in range(start + 1, len(whole) - 1, 97):
        file.write_bytes(whole[:length])
        records = read_records(file)
        assert [next(records) for _ in range(3)] == RECORDS[:3]
        with pytest.raises(InvalidValueError, match=r"^line 4 of .*flights.jsonl is not the record of a flight: "):
            next(records)
