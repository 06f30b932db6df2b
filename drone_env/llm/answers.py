r"""Parse a model's answer into actions, or the reason why it is unusable. Actions are never guessed.

A usable answer consists of the requested actions and nothing else, apart from: a leading `<think>` block, a Markdown
code fence, quotes or emphasis, a full stop, letter case, and a JSON object with one key `action`, `direction`,
`actions` or `directions`. If the prompt allows marks, such as `ACTION:` or `\boxed{}`, the last line with one of them
is the answer, and the rest is ignored.
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, cast, get_args

from pydantic import field_validator
from typing_extensions import TypedDict

from drone_env.core.actions import Action
from drone_env.errors import InvalidValueError
from drone_env.models import Count, Message

AnswerKind = Literal["ok", "parse_error", "illegal", "refusal", "truncated"]
TurnKind = Literal["ok", "repaired", "parse_error", "illegal", "refusal", "truncated", "api_error", "budget_stop"]
TURN_KINDS: tuple[TurnKind, ...] = get_args(TurnKind)
"""The outcomes of a request for actions, including its repair."""
MAX_UNUSABLE = 0.05
"""A run is marked if a larger share of its answers is unusable."""

KEYS = {"action", "direction", "actions", "directions"}
FENCED = re.compile(
    rf"```(?:(?!(?:{'|'.join(Action.__members__)})\b)[a-z]+(?=[\s\[{{]))?(.*)```", re.DOTALL | re.IGNORECASE
)
"""A code fence, optionally with a language; no action is a language."""
# Some chat templates open the block in the prompt, so that the answer contains only its end.
THOUGHT = re.compile(r"\A.*?</think(?:ing)?>", re.DOTALL | re.IGNORECASE)
OPEN_THOUGHT = re.compile(r"\A\s*<think(?:ing)?>", re.IGNORECASE)
REFUSAL = re.compile(
    r"\A\W*(?:i['’]?m sorry|i am sorry|sorry,|i can(?:no|['’])t|i can not|i am (?:not able|unable)"
    r"|i['’]m (?:not able|unable)|i won['’]t|i will not|as an ai\b)",
    re.IGNORECASE,
)
SEPARATOR = re.compile(r"(?:\s|,|;|->|→|\|)+")
WORD = re.compile(r"[A-Za-z_]+\Z")
BOX = r"\boxed{}"
BOXED = re.compile(r"\\boxed\{(?:\\text\{([^{}]*)\}|([^{}]*))\}")
MARK = r"[A-Za-z]+:|\\boxed\{\}"
"""Pattern of the marks that a prompt can allow."""


class ChatMessage(TypedDict):
    """One message of a request."""

    role: str
    content: str


class Answer(Message):
    """The endpoint's answer to one call."""

    text: str
    reasoning: str | None = None
    tool_arguments: str | None = None
    refusal: str | None = None
    finish_reason: str | None = None
    prompt_tokens: Count | None = None
    completion_tokens: Count | None = None
    model: str | None = None

    @field_validator("text", "reasoning", "tool_arguments", "refusal", "finish_reason", "model")
    @classmethod
    def _writable(cls, text: str | None) -> str | None:
        # JSON can contain half a character, which cannot be encoded.
        return text and text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")


class Unusable(NamedTuple):
    """The number of answers that stayed unusable after their repair, and of all answers."""

    answers: int
    of: int

    @classmethod
    def among(cls, turns: Mapping[TurnKind, int]) -> "Unusable":
        """Those of a run or a flight, given the number of requests for actions by outcome."""
        answered = {kind: count for kind, count in turns.items() if kind not in ("api_error", "budget_stop")}
        unusable = sum(count for kind, count in answered.items() if kind not in ("ok", "repaired"))
        return cls(unusable, sum(answered.values()))

    @property
    def share(self) -> float | None:
        """The share of unusable answers; None if there is no answer."""
        return self.answers / self.of if self.of else None

    @property
    def marked(self) -> bool:
        """Whether the share is above `MAX_UNUSABLE`."""
        return self.answers > MAX_UNUSABLE * self.of

    def to_dict(self) -> dict[str, Any]:
        """The numbers as JSON values."""
        return {**self._asdict(), "share": self.share, "marked": self.marked}

    def __str__(self) -> str:
        mark = " !" if self.marked else ""
        return "-" if self.share is None else f"{self.share:.1%} ({self.answers} of {self.of}){mark}"

    @property
    def mark(self) -> str:
        """Why a run is marked; empty if it is not."""
        share = f"{self.answers} of {self.of} answers were unusable, more than {MAX_UNUSABLE:.0%}"
        return f"MARKED: {share}; the drone waited instead" if self.marked else ""


class Reading(NamedTuple):
    """A parsed answer: `actions` is empty unless `kind` is ok."""

    kind: AnswerKind
    actions: tuple[Action, ...]
    reason: str
    """Why it is not ok; empty if it is."""
    text: str
    """The arguments of the tool call, if there is one; else the text."""


def read_answer(answer: Answer, plan: bool, marks: Sequence[str] = ()) -> Reading:
    """Parse an answer.

    Args:
        answer: The answer.
        plan: Whether the prompt asks for a whole route; else for exactly one action.
        marks: Marks that can start the line of the answer.
    """
    content = answer.text if answer.tool_arguments is None else answer.tool_arguments

    def unusable(kind: AnswerKind, reason: str) -> Reading:
        return Reading(kind, (), reason, content)

    if answer.refusal or answer.finish_reason == "content_filter":
        return unusable("refusal", "the model refused")
    # Even if the received part looks complete, the rest is unknown.
    if answer.finish_reason == "length":
        return unusable("truncated", "the answer was cut at the limit of tokens")
    text = THOUGHT.sub("", content, count=1)
    if text == content and OPEN_THOUGHT.match(content):
        return unusable("truncated", "the answer ends inside its <think> block")
    marked = _last_marked(text, marks)
    words = _words(text if marked is None else marked, plan)
    if words is None and marked is None and REFUSAL.match(text):
        return unusable("refusal", "the model refused")
    if words is None:
        expected = "a list of actions" if plan else "one action"
        part = f"the last line with {marks[0]}" if marked is not None else "the answer"
        missing = f", and has no line with {marks[0]}" if marks and marked is None else ""
        return unusable("parse_error", f"{part} is not {expected}{missing}" if text.strip() else "the answer is empty")
    try:
        return Reading("ok", actions_named(words), "", content)
    except InvalidValueError as error:
        return unusable("illegal", str(error))


def actions_named(words: Sequence[object]) -> tuple[Action, ...]:
    """The actions with these names, in any letter case.

    Raises:
        InvalidValueError: if a word is anything else.
    """
    for word in words:
        if not isinstance(word, str) or word.upper() not in Action.__members__:
            shown = repr(word[:40]) if isinstance(word, str) else f"a value of type {type(word).__name__}"
            raise InvalidValueError(f"{shown} is not an action")
    return tuple(Action[cast(str, word).upper()] for word in words)


def _last_marked(text: str, marks: Sequence[str]) -> str | None:
    """The content of the last line with a mark; None if there is none."""
    words = "|".join(re.escape(mark[:-1]) for mark in marks if mark != BOX)
    pattern = re.compile(rf"[\s>*_`#-]*(?:{words})[\s*_`]*:(.*)", re.IGNORECASE) if words else None
    for line in reversed(text.splitlines()):
        match = pattern.match(line) if pattern else None
        content = match[1] if match else line
        boxes = [inner or outer for inner, outer in BOXED.findall(content)] if BOX in marks else []
        if match and not (boxes and not BOXED.sub("", content).strip(" $*_.")):
            return content
        if boxes:
            # Two boxes together are unusable: neither is chosen.
            return " or ".join(boxes)
    return None


def _words(text: str, plan: bool) -> list[str] | None:
    """The words of a text that can be actions; None if it is something else."""
    fenced = FENCED.fullmatch(text.strip())
    text = (fenced[1] if fenced else text).strip()
    if text[:1] in ("{", "["):
        return _json_words(text, plan)
    text = text.strip(" \t\r\n*_`'\".")
    words = [word.strip("*_`'\".") for word in SEPARATOR.split(text) if word] if plan else [text]
    if not words or not all(WORD.match(word) for word in words):
        return None
    if plan and len(words) > 1 and not any(word.upper() in Action.__members__ for word in words):
        return None  # prose
    return words


def _json_words(text: str, plan: bool) -> list[str] | None:
    try:
        value: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if isinstance(value, dict):
        table = cast(dict[str, Any], value)
        keys = list(table)
        if len(keys) != 1 or keys[0].lower() not in KEYS:
            return None
        value = table[keys[0]]
    if plan:
        words = cast(list[Any], value) if isinstance(value, list) else []
        return words if words and all(isinstance(word, str) for word in words) else None
    return [value] if isinstance(value, str) else None
