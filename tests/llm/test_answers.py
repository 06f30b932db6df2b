"""What a model's answer comes to: an action, a route, or why it is none."""

import pytest

from drone_env.core.actions import Action
from drone_env.llm.answers import Answer, Unusable, read_answer


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("UP", "ok"),
        (" up \n", "ok"),
        ('"WAIT".', "ok"),
        ('{"direction": "DOWN"}', "ok"),
        ("```text\nRIGHT\n```", "ok"),
        ('```json{"action": "UP"}```', "ok"),
        ("```RIGHT```", "ok"),
        ("```", "parse_error"),
        ("```json" + " \n" * 10_000 + "x", "parse_error"),
        ("reasoned in the prompt's own block</think>\n\nRIGHT", "ok"),
        ("UP or DOWN", "parse_error"),
        ("Not UP, but DOWN.", "parse_error"),
        ('{"action": "UP", "then": "DOWN"}', "parse_error"),
        ('{"flight": "UP"}', "parse_error"),
        ('{"action": "UP"', "parse_error"),
        ("[" * 100_000, "parse_error"),
        ("<think>UP", "truncated"),
        ("Upwards", "illegal"),
        ("I cannot do that.", "refusal"),
    ],
)
def test_one_action(text: str, kind: str) -> None:
    assert read_answer(Answer(text=text), plan=False).kind == kind


@pytest.mark.parametrize(
    ("marks", "kind"),
    [
        ({"finish_reason": "length"}, "truncated"),
        ({"finish_reason": "content_filter"}, "refusal"),
        ({"refusal": "no"}, "refusal"),
    ],
)
def test_answers_that_the_endpoint_marks(marks: dict[str, str], kind: str) -> None:
    assert read_answer(Answer(text="RIGHT", **marks), plan=False).kind == kind


@pytest.mark.parametrize(
    ("turns", "told"),
    [
        ({"ok": 18, "repaired": 1, "illegal": 1, "api_error": 5, "budget_stop": 1}, "5.0% (1 of 20)"),
        ({"ok": 18, "truncated": 1}, "5.3% (1 of 19) !"),
        ({"api_error": 1}, "-"),
    ],
)
def test_a_run_is_marked_if_more_than_one_answer_in_20_was_unusable(turns: dict[str, int], told: str) -> None:
    assert str(Unusable.among(turns)) == told


def test_half_a_character_can_be_kept() -> None:
    answer = Answer(text="UP\ud800", reasoning="\ud83d\ude81")
    assert (answer.text, answer.reasoning) == ("UP\ufffd", "\U0001f681")
    assert Answer.model_validate_json(answer.model_dump_json()) == answer


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"actions": ["RIGHT", "up"]}', [Action.RIGHT, Action.UP]),
        ("RIGHT, UP", [Action.RIGHT, Action.UP]),
        ("right -> up\nDOWN", [Action.RIGHT, Action.UP, Action.DOWN]),
        ("RIGHT", [Action.RIGHT]),
        ("```RIGHT UP```", [Action.RIGHT, Action.UP]),
        ('{"actions": []}', "parse_error"),
        ('{"actions": ["RIGHT", 3]}', "parse_error"),
        ("First RIGHT, then UP!", "parse_error"),
        ('{"actions": ["RIGHT", "FORWARD"]}', "illegal"),
    ],
)
def test_a_route(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), plan=True)
    assert (list(reading.actions) or reading.kind) == expected


MARKS = ("ACTION:", "Answer:", r"\boxed{}")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("The parcel lies to the right.\n\nACTION: RIGHT", [Action.RIGHT]),
        ("ACTION: UP would bump.\nSo:\naction: down\nGood luck!", [Action.DOWN]),
        ("So **ACTION: UP**\n- **ACTION:** `UP`.", [Action.UP]),
        ("Hm.\n**Answer**: WAIT", [Action.WAIT]),
        (r"We get $\boxed{\text{LEFT}}$.", [Action.LEFT]),
        ("ACTION: $\\boxed{LEFT}$", [Action.LEFT]),
        ("```\nACTION: LEFT\n```", [Action.LEFT]),
        ("<think>ACTION: UP</think>ACTION: LEFT", [Action.LEFT]),
        ("RIGHT", [Action.RIGHT]),
        # The last marked line counts, whatever the ones before it say, and nothing is guessed in its place.
        ("ACTION: UP\nACTION: NORTH", "illegal"),
        ("ACTION: UP\nACTION: up or down", "parse_error"),
        (r"\boxed{UP} or \boxed{DOWN}", "parse_error"),
        (r"ACTION: UP, not \boxed{DOWN}", "parse_error"),
        ("<think>ACTION: UP</think>Let us go up.", "parse_error"),
        ("Final move: UP", "parse_error"),
        ("I can't do that.", "refusal"),
        ("ACTION: UP" + " " * 100_000 + "x", "parse_error"),
        ("\\boxed{" + " " * 100_000, "parse_error"),
    ],
)
def test_an_action_behind_thoughts(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), False, MARKS)
    assert (list(reading.actions) or reading.kind) == expected


def test_marks_count_only_where_the_prompt_allows_them() -> None:
    assert read_answer(Answer(text="ACTION: UP"), False).kind == "parse_error"
    assert read_answer(Answer(text="Answer: UP"), False, MARKS[:1]).kind == "parse_error"
    assert read_answer(Answer(text=r"\boxed{UP}"), False, MARKS[:2]).kind == "parse_error"
    unmarked = read_answer(Answer(text="Let us go up."), False, MARKS)
    assert unmarked.reason == "the answer is not one action, and has no line with ACTION:"


def test_a_route_behind_thoughts() -> None:
    said = "First to the right.\nACTIONS: RIGHT, up -> DOWN\n"
    assert read_answer(Answer(text=said), True, ("ACTIONS:",)).actions == (Action.RIGHT, Action.UP, Action.DOWN)
    assert read_answer(Answer(text=r"\boxed{UP} and \boxed{DOWN}"), True, MARKS).kind == "illegal"
    assert read_answer(Answer(text='ACTIONS: {"actions": ["UP"]}'), True, ("ACTIONS:",)).actions == (Action.UP,)
