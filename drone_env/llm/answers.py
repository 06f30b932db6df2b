r"""What a model's answer means: actions, or why it is none. Nobody guesses what was meant.

An answer is usable where, apart from its packaging, it is the asked-for actions and nothing else. Packaging is: a
leading `<think>` block, a Markdown code fence, quotes or emphasis, a full stop, upper or lower case, and a JSON object
with one key `action`, `direction`, `actions` or `directions`. Where a prompt allows marks, such as `ACTION:` or
`\boxed{}`, the last line with one of them is the answer, and all around it is thought.
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, cast, get_args

from pydantic import field_validator

from drone_env.core.actions import Action
from drone_env.models import Count, Message

AnswerKind = Literal["ok", "parse_error", "illegal", "refusal", "truncated"]
TurnKind = Literal["ok", "repaired", "parse_error", "illegal", "refusal", "truncated", "api_error", "budget_stop"]
TURN_KINDS: tuple[TurnKind, ...] = get_args(TurnKind)
"""How a request for actions came out, its repair counted in."""
MOST_UNUSABLE = 0.05
"""A run is marked if a larger share of its answers was unusable."""

KEYS = {"action", "direction", "actions", "directions"}
FENCED = re.compile(
    rf"```(?:(?!(?:{'|'.join(Action.__members__)})\b)[a-z]+(?=[\s\[{{]))?(.*)```", re.DOTALL | re.IGNORECASE
)
"""A code fence, optionally with a language; no action is a language."""
# Some servers' chat templates open the block in the prompt, so that only its end is in the answer.
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
"""What a prompt may name as a mark, as a pattern."""


class Answer(Message):
    """What the endpoint sent for one call."""

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
        # JSON may hold half a character, which no file can.
        return text and text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")


class Unusable(NamedTuple):
    """How many answers were unusable, after their repair, of how many that came."""

    answers: int
    of: int

    @classmethod
    def among(cls, turns: Mapping[TurnKind, int]) -> "Unusable":
        """Those of a run or a flight.

        Args:
            turns: How many requests for actions came out in which way.
        """
        came = {kind: count for kind, count in turns.items() if kind not in ("api_error", "budget_stop")}
        return cls(sum(count for kind, count in came.items() if kind not in ("ok", "repaired")), sum(came.values()))

    @property
    def share(self) -> float | None:
        """Their share; None if no answer came."""
        return self.answers / self.of if self.of else None

    @property
    def marked(self) -> bool:
        """Whether the share is above `MOST_UNUSABLE`: the score then says little about the model."""
        return self.answers > MOST_UNUSABLE * self.of

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {**self._asdict(), "share": self.share, "marked": self.marked}

    def __str__(self) -> str:
        mark = " !" if self.marked else ""
        return "-" if self.share is None else f"{self.share:.1%} ({self.answers} of {self.of}){mark}"

    @property
    def mark(self) -> str:
        """Why a run is marked, in words; empty if it is not."""
        share = f"{self.answers} of {self.of} answers were unusable, more than {MOST_UNUSABLE:.0%}"
        return f"MARKED: {share}; the drone waited instead" if self.marked else ""


class Reading(NamedTuple):
    """An answer as it was understood: `actions` is empty unless `kind` is ok."""

    kind: AnswerKind
    actions: tuple[Action, ...]
    reason: str
    """Why it is not ok, in words; empty where it is."""
    text: str
    """What was read: the arguments of the tool call, where there is one."""


def read_answer(answer: Answer, plan: bool, marks: Sequence[str] = ()) -> Reading:
    """Understand an answer.

    Args:
        answer: What was sent.
        plan: Whether a whole route was asked for; else exactly one action.
        marks: Marks that may begin the line of the answer.
    """
    said = answer.text if answer.tool_arguments is None else answer.tool_arguments

    def unusable(kind: AnswerKind, reason: str) -> Reading:
        return Reading(kind, (), reason, said)

    if answer.refusal or answer.finish_reason == "content_filter":
        return unusable("refusal", "the model refused")
    # Also where the piece that arrived looks whole: nobody knows what would have followed.
    if answer.finish_reason == "length":
        return unusable("truncated", "the answer was cut at the limit of tokens")
    text = THOUGHT.sub("", said, count=1)
    if text == said and OPEN_THOUGHT.match(said):
        return unusable("truncated", "the answer ends inside its <think> block")
    marked = _last_marked(text, marks)
    words = _words(text if marked is None else marked, plan)
    if words is None and marked is None and REFUSAL.match(text):
        return unusable("refusal", "the model refused")
    if words is None:
        asked = "a list of actions" if plan else "one action"
        where = f"the last line with {marks[0]}" if marked is not None else "the answer"
        missing = f", and has no line with {marks[0]}" if marks and marked is None else ""
        return unusable("parse_error", f"{where} is not {asked}{missing}" if text.strip() else "the answer is empty")
    unknown = [word for word in words if word.upper() not in Action.__members__]
    if unknown:
        return unusable("illegal", f"{unknown[0][:40]!r} is not an action")
    return Reading("ok", tuple(Action[word.upper()] for word in words), "", said)


def _last_marked(text: str, marks: Sequence[str]) -> str | None:
    """What stands behind or in the mark of the last line that has one; None where none has."""
    begins = "|".join(re.escape(mark[:-1]) for mark in marks if mark != BOX)
    begun = re.compile(rf"[\s>*_`#-]*(?:{begins})[\s*_`]*:(.*)", re.IGNORECASE) if begins else None
    for line in reversed(text.splitlines()):
        found = begun.match(line) if begun else None
        said = found[1] if found else line
        boxes = [inner or outer for inner, outer in BOXED.findall(said)] if BOX in marks else []
        if found and not (boxes and not BOXED.sub("", said).strip(" $*_.")):
            return said
        if boxes:
            # Of two boxes none is picked: together they are no answer.
            return " or ".join(boxes)
    return None


def _words(text: str, plan: bool) -> list[str] | None:
    """The words that stand where actions should; None where there is something else."""
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
