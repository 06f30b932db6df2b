"""What a model's answer comes to: an action, a route, or why it is none."""

import pytest

from drone_env.core.actions import Action
from drone_env.llm.answers import Answer, read_answer


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("UP", "ok"),
        (" up \n", "ok"),
        ("`LEFT`", "ok"),
        ('"WAIT".', "ok"),
        ('{"direction": "DOWN"}', "ok"),
        ("```\nRIGHT\n```", "ok"),
        ("```text\nRIGHT\n```", "ok"),
        ('```json{"action": "UP"}```', "ok"),
        ("```RIGHT```", "ok"),
        ("```", "parse_error"),
        ("```json" + " \n" * 10_000 + "x y```", "parse_error"),
        ("```json" + " \n" * 10_000 + "x", "parse_error"),
        ("reasoned in the prompt's own block</think>\n\nRIGHT", "ok"),
        ("UP UP", "parse_error"),
        ("UP or DOWN", "parse_error"),
        ("Not UP, but DOWN.", "parse_error"),
        ('{"action": "UP", "then": "DOWN"}', "parse_error"),
        ('{"action": ["UP"]}', "parse_error"),
        ('{"flight": "UP"}', "parse_error"),
        ('{"then": "DOWN", "action": "UP"}', "parse_error"),
        ('{"action": "UP"', "parse_error"),
        ("[" * 100_000, "parse_error"),
        ("0", "parse_error"),
        ("<think>UP", "truncated"),
        ("<think></think>", "parse_error"),
        ("Upwards", "illegal"),
        ("I can't do that.", "refusal"),
        ("I cannot do that.", "refusal"),
    ],
)
def test_one_action(text: str, kind: str) -> None:
    assert read_answer(Answer(text=text), plan=False).kind == kind


def test_half_a_character_can_be_kept() -> None:
    answer = Answer(text="UP\ud800", reasoning="\ud83d\ude81")
    assert (answer.text, answer.reasoning) == ("UP\ufffd", "\U0001f681")
    assert Answer.model_validate_json(answer.model_dump_json()) == answer


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"actions": ["RIGHT", "up"]}', [Action.RIGHT, Action.UP]),
        ('["RIGHT", "UP"]', [Action.RIGHT, Action.UP]),
        ("RIGHT, UP", [Action.RIGHT, Action.UP]),
        ("right -> up\nDOWN", [Action.RIGHT, Action.UP, Action.DOWN]),
        ("RIGHT", [Action.RIGHT]),
        ("```RIGHT UP```", [Action.RIGHT, Action.UP]),
        ("```plain RIGHT UP```", [Action.RIGHT, Action.UP]),
        ('{"actions": []}', "parse_error"),
        ('{"actions": ["RIGHT", 3]}', "parse_error"),
        ("First RIGHT, then UP!", "parse_error"),
        ("Let us go north", "parse_error"),
        ('{"route": ["RIGHT"]}', "parse_error"),
        ('{"actions": ["RIGHT", "FORWARD"]}', "illegal"),
    ],
)
def test_a_route(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), plan=True)
    assert (list(reading.actions) or reading.kind) == expected
