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
RIGHT = [
    *(
        "RIGHT",
        " right \n",
        "\r\nRIGHT\r\n",
        '"RIGHT".',
        "“RIGHT”",
        "**RIGHT**",
        "(RIGHT)",
        "<RIGHT>",
        "$RIGHT$",
        "RIGHT!",
    ),
    *("RIGHT,", "- RIGHT", "1. RIGHT", "(1) RIGHT", "Step 3: RIGHT", "> RIGHT", "→ RIGHT", "[RIGHT]"),
    # Unicode.
    *("RIGHT\u00a0", "\u200bRIGHT", "\ufeffRIGHT", "RI\u00adGHT", "ＲＩＧＨＴ", "RIGHT！", "RIGHT\u2028"),
    # Labels and wrappers.
    *(
        "ACTION: RIGHT",
        "**Answer:** RIGHT",
        "Final answer: RIGHT",
        "The next move: RIGHT.",
        "The answer is: RIGHT",
        "Answer：RIGHT",
        '"action": "RIGHT"',
    ),
    *(r"\boxed{RIGHT}", r"$\boxed{\text{RIGHT}}$", "<action>RIGHT</action>", "<answer>\nACTION: RIGHT\n</answer>"),
    *("```text\nRIGHT\n```", "```RIGHT```", 'Answer:\n```json\n["RIGHT"]\n```'),
    # JSON, and what is nearly JSON.
    *('{"action": "RIGHT"}', '{"Direction": "right"}', '{"move": "RIGHT"}', '["RIGHT"]', '{"route": ["RIGHT"]}'),
    *('```json\n{"action": "RIGHT"}\n```', '{"actions": [{"action": "RIGHT"}]}', "{'action': 'RIGHT'}", '["RIGHT",]'),
    *('{"reasoning": "It is not left.", "action": "RIGHT"}', '{"action": "RIGHT."}', "{“action”: “RIGHT”}"),
    # Tool calls that a server passes on as text.
    *('<tool_call>\n{"name": "fly", "arguments": {"direction": "RIGHT"}}\n</tool_call>', '[fly(direction="RIGHT")]'),
    '<|python_tag|>{"name": "fly", "parameters": {"direction": "RIGHT"}}<|eom_id|>',
    '<|channel|>commentary to=functions.fly <|constrain|>json<|message|>{"direction": "RIGHT"}<|call|>',
    # Special tokens of chat templates.
    *(
        "RIGHT<|im_end|>",
        "RIGHT<|eot_id|>",
        "<s> RIGHT</s>",
        " RIGHT<end_of_turn>\n",
        "RIGHT<｜end▁of▁sentence｜>",
        "RIGHT[/INST]",
    ),
    *("RIGHT<|im_end|>\n<|im_start|>user\nUP", "<|im_start|>assistant\nRIGHT<|im_end|>", "assistant\n\nRIGHT"),
    *(
        "<start_of_turn>model\nRIGHT",
        "<|start_header_id|>assistant<|end_header_id|>\n\nRIGHT",
        "<|begin_of_box|>RIGHT<|end_of_box|>",
    ),
    # Thoughts.
    *(
        "<think>UP</think>RIGHT",
        "<think>\n\n</think>\n\nRIGHT",
        "from the template</think>\n\nRIGHT",
        "<think>a</think><think>b</think>RIGHT",
    ),
    *(
        "[THINK]UP[/THINK]RIGHT",
        "◁think▷UP◁/think▷RIGHT",
        "<seed:think>UP</seed:think>RIGHT",
        "<thought>UP</thought>RIGHT",
    ),
    *("<reasoning>UP</reasoning>\n<answer>RIGHT</answer>", "<|channel>thought\nUP<channel|>RIGHT"),
    "<|START_THINKING|>UP<|END_THINKING|><|START_RESPONSE|>RIGHT<|END_RESPONSE|>",
    "<|channel|>analysis<|message|>UP?<|end|><|start|>assistant<|channel|>final<|message|>RIGHT<|return|>",
    *("analysisUP, or not.assistantfinalRIGHT", "assistantfinal RIGHT"),
]
"""Spellings of one answer that models and servers really send."""


@pytest.mark.parametrize("text", RIGHT)
def test_one_action_is_read_in_every_spelling_on_every_prompt(text: str) -> None:
    for plan, marks in itertools.product((False, True), ((), MARKS)):
        assert read_answer(Answer(text=text), plan, marks) == ("ok", (Action.RIGHT,), "", text)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        *(
            (text, "parse_error")
            for text in ("", "```", "<|im_end|>", "\u200b", "3", "RIGHT x3", "RIGHT 3", "➡️ RIGHT", "RIGHT?")
        ),
        # Prose.
        *((text, "parse_error") for text in ("I will go RIGHT.", "The answer is RIGHT.", "RIGHT, since it is near.")),
        *((text, "parse_error") for text in ("Not UP, but DOWN.", "analysisWe go RIGHT.", "RIGHT\n\nIt is near.")),
        # Two actions where one is asked for.
        *(
            (text, "parse_error")
            for text in ("UP or DOWN", "RIGHT RIGHT", '["UP", "DOWN"]', "Answer: UP\nAnswer: DOWN")
        ),
        *((text, "parse_error") for text in ('{"action": "UP", "then": "DOWN"}', '{"action": "UP", "action": "DOWN"}')),
        *((text, "parse_error") for text in ('{"direction": "UP"}{"direction": "UP"}', r"\boxed{UP} or \boxed{DOWN}")),
        ("<answer>UP</answer><answer>DOWN</answer>", "parse_error"),
        # JSON of another form, or without its end.
        *(
            (text, "parse_error")
            for text in ('{"flight": "UP"}', '{"action": "UP"', '{"action": 3}', '{"actions": []}', "[" * 100_000)
        ),
        ("```json" + " \n" * 10_000 + "x", "parse_error"),
        *(
            (text, "truncated")
            for text in ("<think>UP", "[THINK]UP", "<|channel|>analysis<|message|>UP", "<|START_THINKING|>UP")
        ),
        *((text, "illegal") for text in ("Upwards", "NORTH", "{'action': 'FORWARD'}", "Sure!")),
        *((text, "refusal") for text in ("I cannot do that.", "I’m sorry, but no.")),
    ],
)
def test_nothing_else_is_an_action(text: str, kind: str) -> None:
    assert read_answer(Answer(text=text), plan=False).kind == kind


REAL = json.loads(Path(__file__).with_name("real_answers.json").read_text(encoding="utf-8"))
"""Answers of a small language model, and how a person reads them."""


@pytest.mark.parametrize("real", REAL, ids=lambda real: f"{real['prompt']}: {real['text'][:30]}")
def test_answers_of_a_real_model(real: dict[str, Any]) -> None:
    reading = get_prompt(real["prompt"]).read_answer(Answer(text=real["text"]))
    assert ([action.name for action in reading.actions] or reading.kind) == real["expected"]


FRAGMENTS = st.sampled_from(
    [
        *Action.__members__,
        *RIGHT,
        "up",
        ", ",
        "\n",
        " ",
        ".",
        "...",
        "2.",
        '"',
        "[",
        "]",
        "{",
        "}",
        '"move": ',
        "ACTION: ",
    ]
)


@settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "200")), deadline=None, derandomize=True)
@given(st.lists(FRAGMENTS | st.text(max_size=6), max_size=8).map("".join), st.booleans(), st.sampled_from([(), MARKS]))
def test_the_actions_are_words_of_the_answer_or_there_are_none(text: str, plan: bool, marks: tuple[str, ...]) -> None:
    reading = read_answer(Answer(text=text), plan, marks)
    plain = unicodedata.normalize("NFKC", text.replace("\u00ad", "")).upper()
    for action in set(reading.actions):
        assert plain.count(action.name) >= reading.actions.count(action)
    assert (reading.kind == "ok") == bool(reading.actions) == (not reading.reason)
    assert plan or len(reading.actions) <= 1


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        *(
            (reason, "ok")
            for reason in (None, "", "stop", "STOP", "eos_token", "stop_sequence", "end_turn", "tool_calls")
        ),
        *((reason, "ok") for reason in ("function_call", "function_call_filter: MALFORMED_FUNCTION_CALL")),
        *((reason, "truncated") for reason in ("length", "MAX_TOKENS", "model_length", "repetition")),
        *((reason, "refusal") for reason in ("content_filter", "SAFETY", "content_filter: RECITATION", "sensitive")),
    ],
)
def test_the_finish_reason_decides_whether_an_answer_counts(reason: str | None, kind: str) -> None:
    assert read_answer(Answer(text="RIGHT", finish_reason=reason), plan=False).kind == kind


@pytest.mark.parametrize("reason", ["abort", "cancelled", "insufficient_system_resource", "error", "timeout", "new"])
def test_an_answer_that_the_server_did_not_finish_is_none(reason: str) -> None:
    with pytest.raises(EndpointError, match=f"not finished: finish reason '{reason}'"):
        read_answer(Answer(text="RIGHT", finish_reason=reason), plan=True)


def test_a_refusal_beside_the_answer() -> None:
    assert read_answer(Answer(text="RIGHT", refusal="no"), plan=False).kind == "refusal"


@pytest.mark.parametrize(
    ("unusable", "told"),
    [
        ([], ""),
        (
            ["Let us\ngo up!", "NORTH", "I go right. " * 20],
            "2 of 3 unusable answers are parse_error, such as 'Let us go up!': the answer is not one action",
        ),
        (
            ["<think>Hm."],
            "1 of 1 unusable answers are truncated, such as '<think>Hm.': the answer ends inside its thoughts; raise "
            "--max-answer-tokens",
        ),
    ],
)
def test_what_unusable_answers_have_in_common(unusable: list[str], told: str) -> None:
    assert in_common([read_answer(Answer(text=text), plan=False) for text in unusable]) == told


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
    "text",
    [
        *(
            "RIGHT UP DOWN",
            "RIGHT, up; DOWN",
            "right -> up\nDOWN",
            "RIGHT=>UP=>DOWN",
            "RIGHT | UP | DOWN",
            "[RIGHT, UP, DOWN]",
        ),
        *(
            "1. RIGHT\n2. UP\n3. DOWN",
            "1) **RIGHT**\n2) **UP**\n3) **DOWN**",
            "Step 1: RIGHT\nStep 2: UP\nStep 3: DOWN",
        ),
        *("- RIGHT\n- UP\n- DOWN", "* RIGHT\n* UP\n* DOWN", "• RIGHT\n• UP\n• DOWN", "Route: RIGHT, UP, DOWN"),
        *(
            '["RIGHT", "UP", "DOWN"]',
            '{"actions": ["RIGHT", "up", "DOWN"]}',
            '{"route": "RIGHT UP DOWN"}',
            "RIGHT UP DOWN</s>",
        ),
        *("['RIGHT', 'UP', 'DOWN']", '{"plan": ["RIGHT", "UP", "DOWN",]}', 'Route: ["RIGHT", "UP", "DOWN"]'),
        '[{"step": 1, "action": "RIGHT"}, {"step": 2, "action": "UP"}, {"step": 3, "action": "DOWN"}]',
        "```json\n" + '{"actions": [\n"RIGHT",\n"UP",\n"DOWN"\n]}' + "\n```",
    ],
)
def test_a_route_is_read_in_every_spelling(text: str) -> None:
    assert read_answer(Answer(text=text), plan=True).actions == (Action.RIGHT, Action.UP, Action.DOWN)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('{"actions": []}', "parse_error"),
        ('{"actions": ["RIGHT", 3]}', "parse_error"),
        ('{"actions": ["RIGHT", "FORWARD"]}', "illegal"),
        ("First RIGHT, then UP!", "illegal"),
        ("UP: left, DOWN: right", "parse_error"),
        # The whole route is not there.
        *(
            (text, "parse_error")
            for text in ("RIGHT, UP, ...", "RIGHT x3, UP", "1. RIGHT\n2.", '{"actions": ["RIGHT", "UP"')
        ),
        ('["RIGHT", "..."]', "parse_error"),
    ],
)
def test_what_is_no_route(text: str, kind: str) -> None:
    assert read_answer(Answer(text=text), plan=True).kind == kind


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
        ("Hm.\nFinal move: UP", "parse_error"),
        ("Hm.\nACTION:\n\nUP\nGood luck!", [Action.UP]),
        ("I can't do that.", "refusal"),
        ("ACTION: UP" + " " * 100_000 + "x", "parse_error"),
        ("\\boxed{" + " " * 100_000, "parse_error"),
    ],
)
def test_an_action_behind_thoughts(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), False, MARKS)
    assert (list(reading.actions) or reading.kind) == expected


def test_marks_count_only_where_the_prompt_allows_them() -> None:
    for text, marks in (("Hm.\nACTION: UP", ()), ("Hm.\nAnswer: UP", MARKS[:1]), (r"So \boxed{UP}", MARKS[:2])):
        assert read_answer(Answer(text=text), False, marks).kind == "parse_error"
    unmarked = read_answer(Answer(text="Let us go up."), False, MARKS)
    assert unmarked.reason == "the answer is not one action, and has no line with ACTION:"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("First to the right.\nACTIONS: RIGHT, up -> DOWN\n\nDone!", (Action.RIGHT, Action.UP, Action.DOWN)),
        ("Hm.\nACTIONS:\n1. RIGHT\n2. UP\n", (Action.RIGHT, Action.UP)),
        # A route that goes on in the next line is read to its end.
        ("Hm.\nACTIONS: RIGHT,\nUP", (Action.RIGHT, Action.UP)),
        ('ACTIONS: {"actions": ["UP"]}', (Action.UP,)),
        (r"So \boxed{UP} and \boxed{DOWN}", "illegal"),
    ],
)
def test_a_route_behind_thoughts(text: str, expected: object) -> None:
    reading = read_answer(Answer(text=text), True, ("ACTIONS:", r"\boxed{}"))
    assert (reading.actions or reading.kind) == expected
