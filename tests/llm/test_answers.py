"""What a model's answer comes to: an action, a route, or why it is none."""

import itertools
import json
import os
import unicodedata
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.core.actions import Action
from drone_env.errors import EndpointError
from drone_env.llm.answers import Answer, Unusable, in_common, read_answer
from drone_env.llm.prompt import get_prompt

MARKS = ("ACTION:", "Answer:", r"\boxed{}")
SPELLINGS: dict[str, Any] = json.loads(Path(__file__).with_name("answers.json").read_text(encoding="utf-8"))
"""What models and servers really send: spellings of RIGHT, of RIGHT UP DOWN, and what is neither; with answers of a
small language model, and how a person reads them."""


def names(text: str, plan: bool, marks: tuple[str, ...] = ()) -> object:
    """The names of the actions of an answer, or its kind."""
    reading = read_answer(Answer(text=text), plan, marks)
    return [action.name for action in reading.actions] or reading.kind


@pytest.mark.parametrize("text", SPELLINGS["action"])
def test_one_action_is_read_in_every_spelling_on_every_prompt(text: str) -> None:
    for plan, marks in itertools.product((False, True), ((), MARKS)):
        assert read_answer(Answer(text=text), plan, marks) == ("ok", (Action.RIGHT,), "", text)


@pytest.mark.parametrize(("kind", "texts"), SPELLINGS["no action"].items())
def test_nothing_else_is_an_action(kind: str, texts: list[str]) -> None:
    endless = ["[" * 100_000, "```json" + " \n" * 10_000 + "x"] if kind == "parse_error" else []
    assert [text for text in [*texts, *endless] if names(text, plan=False) != kind] == []


@pytest.mark.parametrize("text", SPELLINGS["route"])
def test_a_route_is_read_in_every_spelling(text: str) -> None:
    assert names(text, plan=True) == ["RIGHT", "UP", "DOWN"]


@pytest.mark.parametrize(("kind", "texts"), SPELLINGS["no route"].items())
def test_what_is_no_route(kind: str, texts: list[str]) -> None:
    assert [text for text in texts if names(text, plan=True) != kind] == []


@pytest.mark.parametrize(("text", "expected"), SPELLINGS["action behind thoughts"])
def test_an_action_behind_thoughts(text: str, expected: object) -> None:
    # The last marked line counts, whatever the ones before it say, and nothing is guessed in its place.
    assert names(text, False, MARKS) == expected


@pytest.mark.parametrize("text", ["ACTION: UP" + " " * 100_000 + "x", "\\boxed{" + " " * 100_000])
def test_endless_answers_take_no_endless_time(text: str) -> None:
    assert names(text, False, MARKS) == "parse_error"


@pytest.mark.parametrize(("text", "expected"), SPELLINGS["route behind thoughts"])
def test_a_route_behind_thoughts(text: str, expected: object) -> None:
    assert names(text, True, ("ACTIONS:", r"\boxed{}")) == expected


@pytest.mark.parametrize(
    "real", SPELLINGS["of a real model"], ids=lambda real: f"{real['prompt']}: {real['text'][:30]}"
)
def test_answers_of_a_real_model(real: dict[str, Any]) -> None:
    prompt = get_prompt(real["prompt"])
    assert names(real["text"], prompt.plan, prompt.marks) == real["expected"]


def test_marks_count_only_where_the_prompt_allows_them() -> None:
    for text, marks in (("Hm.\nACTION: UP", ()), ("Hm.\nAnswer: UP", MARKS[:1]), (r"So \boxed{UP}", MARKS[:2])):
        assert names(text, False, marks) == "parse_error"
    unmarked = read_answer(Answer(text="Let us go up."), False, MARKS)
    assert unmarked.reason == "the answer is not one action, and has no line with ACTION:"


@pytest.mark.parametrize("text", ["B", "b.", "Letter: B", "The letter is: B", "Next stop: **B**", '{"letter": "B"}'])
def test_a_stop_is_read_in_every_spelling(text: str) -> None:
    ways = {"A": [Action.UP], "B": [Action.RIGHT, Action.RIGHT]}
    assert read_answer(Answer(text=text), False, (), ways).actions == (Action.RIGHT, Action.RIGHT)


PARTS = ["up", ", ", "\n", " ", ".", "...", "2.", '"', "[", "]", "{", "}", '"move": ', "ACTION: "]
FRAGMENTS = st.sampled_from([*Action.__members__, *SPELLINGS["action"], *PARTS])


@settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "50")), deadline=None, derandomize=True)
@given(st.lists(FRAGMENTS | st.text(max_size=6), max_size=8).map("".join), st.booleans(), st.sampled_from([(), MARKS]))
def test_the_actions_are_words_of_the_answer_or_there_are_none(text: str, plan: bool, marks: tuple[str, ...]) -> None:
    reading = read_answer(Answer(text=text), plan, marks)
    plain = unicodedata.normalize("NFKC", text.replace("\u00ad", "")).upper()
    for action in set(reading.actions):
        assert plain.count(action.name) >= reading.actions.count(action)
    assert (reading.kind == "ok") == bool(reading.actions) == (not reading.reason)
    assert plan or len(reading.actions) <= 1


@pytest.mark.parametrize(
    ("kind", "reasons"),
    [
        ("ok", [None, "", "stop", "STOP", "eos_token", "stop_sequence", "end_turn", "tool_calls"]),
        ("ok", ["function_call", "function_call_filter: MALFORMED_FUNCTION_CALL"]),
        ("truncated", ["length", "MAX_TOKENS", "model_length", "repetition"]),
        ("refusal", ["content_filter", "SAFETY", "content_filter: RECITATION", "sensitive"]),
    ],
)
def test_the_finish_reason_decides_whether_an_answer_counts(kind: str, reasons: list[str | None]) -> None:
    answers = [Answer(text="RIGHT", finish_reason=reason) for reason in reasons]
    assert {read_answer(answer, plan=False).kind for answer in answers} == {kind}


@pytest.mark.parametrize("reason", ["abort", "cancelled", "insufficient_system_resource", "error", "timeout", "new"])
def test_an_answer_that_the_server_did_not_finish_is_none(reason: str) -> None:
    with pytest.raises(EndpointError, match=f"not finished: finish reason '{reason}'"):
        read_answer(Answer(text="RIGHT", finish_reason=reason), plan=True)


def test_a_refusal_beside_the_answer() -> None:
    assert read_answer(Answer(text="RIGHT", refusal="no"), plan=False).kind == "refusal"


def test_what_unusable_answers_have_in_common() -> None:
    texts = ["Let us\ngo up!", "NORTH", "I go right. " * 20]
    assert in_common([read_answer(Answer(text=text), plan=False) for text in texts]) == (
        "2 of 3 unusable answers are parse_error, such as 'Let us go up!': the answer is not one action"
    )
    assert in_common([read_answer(Answer(text="<think>Hm."), plan=False)]).endswith("or --max-completion-tokens")


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
