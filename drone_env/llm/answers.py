r"""Parse a model's answer into actions, or the reason why it is unusable. Actions are never guessed.

A usable answer consists of the requested actions and nothing else. `_plain` removes what templates and servers leave in
a text: thoughts, special tokens, invisible characters. `_words` removes what models write around an answer: a label,
brackets, quotes, emphasis, list numbers. If the prompt allows marks, such as `ACTION:` or `\boxed{}`, the last line
with one of them is the answer, and the rest is ignored.
"""

import json
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, cast, get_args

from typing_extensions import TypedDict

from drone_env.core.actions import Action
from drone_env.errors import EndpointError, InvalidValueError
from drone_env.models import Count, StrictModel

AnswerKind = Literal["ok", "parse_error", "illegal", "refusal", "truncated"]
TurnKind = Literal["ok", "repaired", "parse_error", "illegal", "refusal", "truncated", "api_error", "budget_stop"]
TURN_KINDS: tuple[TurnKind, ...] = get_args(TurnKind)
"""The outcomes of a request for actions, including its repair."""
MAX_UNUSABLE = 0.05
"""A run is marked if a larger share of its answers is unusable."""
EXAMPLE_CHARACTERS = 80

FinishKind = Literal["complete", "truncated", "refusal", "failed"]
FINISH_REASONS: dict[FinishKind, set[str]] = {
    # Gemini's filter of function calls marks a malformed call: the answer is complete, and unusable.
    "complete": {
        *("stop", "eos", "eos_token", "end_turn", "stop_sequence", "stop_token", "complete", "completed", "endoftext"),
        *("tool_call", "tool_calls", "tool_use", "function_call", "function_call_filter", "malformed_function_call"),
    },
    "truncated": {
        *("length", "max_length", "max_tokens", "max_output_tokens", "max_completion_tokens", "token_limit"),
        *("model_length", "context_length_exceeded", "model_context_window_exceeded", "repetition"),
    },
    "refusal": {
        *("content_filter", "content_filtered", "safety", "recitation", "blocklist", "prohibited_content", "spii"),
        *("refusal", "sensitive", "guardrail_intervened", "error_toxic"),
    },
}
"""Finish reasons of OpenAI's protocol, of the servers that imitate it, and of the vendors behind them."""

KEYS = {
    *("answer", "letter"),
    *(name + end for name in ("action", "direction", "move", "route", "plan", "path", "stop") for end in ("", "s")),
}
ASIDES = {"reason", "reasoning", "rationale", "thought", "thoughts", "thinking", "explanation", "step"}
"""Keys beside the actions that only explain or number them."""
CALL_KEYS = (["name", "arguments"], ["name", "parameters"])
"""The keys of a tool call that a server passes on as text."""
THINK = "(?:seed:)?(?:think|thinking|thought|reasoning)"
HEADER = r"<\|channel\|>(?:final|commentary to=functions\.fly\w*)\b[^<]*(?:<\|constrain\|>\w+\s*)?<\|message\|>"
# Some chat templates open the block in the prompt, so that the answer contains only its end. A server that removes
# special tokens turns the headers of two channels into "analysis...assistantfinal".
THOUGHTS = re.compile(
    rf"\A(?:.*(?:</{THINK}>|\[/THINK\]|◁/think▷|<\|END_THINKING\|>|<\|end_of_thought\|>|<channel\|>|{HEADER})"
    r"|(?:analysis.*)?assistantfinal)",
    re.DOTALL | re.IGNORECASE,
)
OPEN_THOUGHT = re.compile(
    rf"\A\s*(?:<{THINK}>|\[THINK\]|◁think▷|<\|START_THINKING\|>|<\|begin_of_thought\|>|<\|channel>thought"
    r"|(?:<\|start\|>assistant)?<\|channel\|>analysis)",
    re.IGNORECASE,
)
INVISIBLE = re.compile("[\u00ad\u200b-\u200f\u202a-\u202e\u2060-\u2064\ufeff]")
TOKEN = r"(?:<\|[^<>|]{1,40}\|>|</?s>|<(?:bos|eos|start_of_turn|end_of_turn|\|turn|turn\|)>|\[/?INST\])"
"""A special token of a chat template."""
ROLE = re.compile(rf"\A\s*(?:{TOKEN}\s*)*(?:(?:assistant|model)(?:\s*{TOKEN}|[^\S\n]*:?[^\S\n]*\n))?")
"""The header of the model's turn."""
REFUSAL = re.compile(
    r"\A\W*(?:i['’]?m sorry|i am sorry|sorry,|i can(?:no|['’])t|i can not|i am (?:not able|unable)"
    r"|i['’]m (?:not able|unable)|i won['’]t|i will not|as an ai\b)",
    re.IGNORECASE,
)
SEPARATOR = re.compile(r"(?:\s|,|;|[-=]>|→|\|)+")
WORD = re.compile(r"[A-Za-z_]+\Z")
AROUND = " \t\r\n*_`'\"‘’“”«»()<>$.,;!#•–—-"
"""Characters around a word that do not change its meaning."""
NUMBERS = re.compile(
    r"^[ \t*(]*(?:(?:step|move|action)[ \t]*)?\d{1,4}[.):]+(?=[ \t*_`'\"]*[a-z])", re.MULTILINE | re.IGNORECASE
)
"""The numbers of a list."""
WRAPPERS = [
    re.compile(pattern, re.DOTALL | re.IGNORECASE)
    for pattern in (
        # A label, such as `Final answer:`.
        rf"[\s*_`'\"‘“#>-]*(?:(?:final|next|best|my|the|chosen)\s+)*(?:{'|'.join(sorted(KEYS))})(?:\s+is)?[\s*_`'\"’”]*[:=](.*)",
        # A code fence, optionally with a language; no action is a language.
        rf"```(?:(?!(?:{'|'.join(Action.__members__)})\b)[a-z]+(?=[\s\[{{]))?(.*)```",
        rf"<(?:{'|'.join(sorted(KEYS))}|response|output|tool_call)>(.*)</\w+>",
        r"[$\s]*\\(?:boxed|text|textbf|mathbf)\{(.*)\}[$\s.]*",
        r"\[?(?:fly\w*|goto)\((?:(?:directions?|stop)\s*=)?(.*)\)\]?",
        r"\[([^\[\]{}\"]*)\]",
    )
]
"""Labels and brackets around a whole answer."""
END_LINE = re.compile(r"\s*(?:```\w*|</\w+>)\s*")
"""A line that only begins or ends what is around a marked answer."""
BOX = r"\boxed{}"
BOXED = re.compile(r"\\boxed\{(?:\\text\{([^{}]*)\}|([^{}]*))\}")
MARK = r"[A-Za-z]+:|\\boxed\{\}"
"""Pattern of the marks that a prompt can allow."""


class ChatMessage(TypedDict):
    """One message of a request."""

    role: str
    content: str


class Answer(StrictModel):
    """The endpoint's answer to one call."""

    text: str
    reasoning: str | None = None
    tool_arguments: str | None = None
    refusal: str | None = None
    finish_reason: str | None = None
    prompt_tokens: Count | None = None
    completion_tokens: Count | None = None
    model: str | None = None


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
    """Those that it names, or those of the way to the stop that it names."""
    reason: str
    """Why it is not ok; empty if it is."""
    text: str
    """The arguments of the tool call, if there is one; else the text."""


def in_common(faults: Sequence[Reading]) -> str:
    """The commonest kind of unusable answers, with an example; empty if there are none."""
    if not faults:
        return ""
    (kind, count), *_ = Counter(fault.kind for fault in faults).most_common()
    example = next(fault for fault in faults if fault.kind == kind)
    advice = "; raise it: --max-answer-tokens or --max-completion-tokens" if kind == "truncated" else ""
    text = repr(" ".join(example.text.split())[:EXAMPLE_CHARACTERS])
    return f"{count} of {len(faults)} unusable answers are {kind}, such as {text}: {example.reason}{advice}"


def finish_kind(reason: str | None) -> FinishKind:
    """Classify an answer by its finish reason; without one, it is complete."""
    # Gemini's own reason follows a colon, as in "content_filter: RECITATION".
    name = (reason or "stop").partition(":")[0].strip().lower()
    kinds: list[FinishKind] = [kind for kind, names in FINISH_REASONS.items() if name in names]
    return kinds[0] if kinds else "failed"


def read_answer(
    answer: Answer, plan: bool, marks: Sequence[str] = (), ways: Mapping[str, Sequence[Action]] | None = None
) -> Reading:
    """Parse an answer.

    Args:
        answer: The answer.
        plan: Whether the prompt asks for a whole route; else for exactly one action.
        marks: Marks that can start the line of the answer.
        ways: The actions of each stop that the answer can name; None if it names actions.

    Raises:
        EndpointError: if the server did not finish the answer, so that it says nothing about the model.
    """
    content = answer.text if answer.tool_arguments is None else answer.tool_arguments

    def unusable(kind: AnswerKind, reason: str) -> Reading:
        return Reading(kind, (), reason, content)

    finish = finish_kind(answer.finish_reason)
    if finish == "failed":
        raise EndpointError(f"the answer was not finished: finish reason {answer.finish_reason!r}")
    if answer.refusal or finish == "refusal":
        return unusable("refusal", "the model refused")
    # Even if the received part looks complete, the rest is unknown.
    if finish == "truncated":
        return unusable("truncated", "the answer was cut at the limit of tokens")
    text = _plain(content)
    if text is None:
        return unusable("truncated", "the answer ends inside its thoughts")
    marked = _last_marked(text, plan, marks)
    words = _words(text if marked is None else marked)
    if not words and marked is None and REFUSAL.match(text):
        return unusable("refusal", "the model refused")
    if not words or (len(words) > 1 and not plan):
        expected = "a list of actions" if plan else "one action" if ways is None else "one stop"
        part = f"the last line with {marks[0]}" if marked is not None else "the answer"
        missing = f", and has no line with {marks[0]}" if marks and marked is None else ""
        return unusable("parse_error", f"{part} is not {expected}{missing}" if text.strip() else "the answer is empty")
    try:
        return Reading("ok", actions_named(words) if ways is None else way_to(words[0], ways), "", content)
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


def way_to(stop: object, ways: Mapping[str, Sequence[Action]]) -> tuple[Action, ...]:
    """The actions of the way to a stop, in any letter case.

    Raises:
        InvalidValueError: if it is not among the stops.
    """
    label = str(stop).strip().upper()
    if label not in ways:
        raise InvalidValueError(f"{label[:40]!r} is no stop in reach: {', '.join(ways) or 'there is none'}")
    return tuple(ways[label])


def _plain(content: str) -> str | None:
    """The text of the model's turn after its thoughts, without special tokens; None if the thoughts have no end."""
    # Other forms of the same letters and spaces become equal.
    text = INVISIBLE.sub("", unicodedata.normalize("NFKC", content))
    thoughts = THOUGHTS.match(text)
    if thoughts is None and OPEN_THOUGHT.match(text):
        return None
    text = text[thoughts.end() if thoughts else 0 :]
    # Text after the end of the turn belongs to another turn.
    return re.split(TOKEN, ROLE.sub("", text), maxsplit=1)[0]


def _last_marked(text: str, plan: bool, marks: Sequence[str]) -> str | None:
    """The content of the last line with a mark; None if there is none. A route can take several lines."""
    words = "|".join(re.escape(mark[:-1]) for mark in marks if mark != BOX)
    pattern = re.compile(rf"[\s>*_`#-]*(?:{words})[\s*_`]*:(.*)", re.IGNORECASE) if words else None
    lines = [line for line in text.splitlines() if not END_LINE.fullmatch(line)]
    for number, line in reversed(list(enumerate(lines))):
        match = pattern.match(line) if pattern else None
        content = match[1] if match else line
        boxes = [inner or outer for inner, outer in BOXED.findall(content)] if BOX in marks else []
        if match and not (boxes and not BOXED.sub("", content).strip(" $*_.")):
            rest = "\n".join([content.strip("*_` "), *lines[number + 1 :]]).strip()
            return re.split(r"\n\s*\n" if plan else r"\n", rest, maxsplit=1)[0]
        if boxes:
            # Two boxes together are unusable: neither is chosen.
            return " or ".join(boxes)
    return None


def _words(text: str) -> list[str] | None:
    """The words of a text that can be actions; None if it is something else."""
    for wrapper in WRAPPERS * 3:  # one in another
        if match := wrapper.fullmatch(text.strip()):
            text = match[1]
    text = text.strip()
    if text[:1] in ("{", "["):
        return _json_words(text)
    words = [word for part in SEPARATOR.split(NUMBERS.sub("", text)) if (word := part.strip(AROUND))]
    # Dots that replace the rest of a route make it unusable.
    if not words or ".." in text or not all(WORD.match(word) for word in words):
        return None
    if len(words) > 1 and not any(word.upper() in Action.__members__ for word in words):
        return None  # prose
    return words


class _Pairs(list[tuple[str, Any]]):
    """A JSON object, in which a key can occur twice."""


def _json_words(text: str) -> list[str] | None:
    """The words in a JSON value, which can have Python's quotes, and a comma at the end of a list."""
    for spelling in (text, re.sub(r",\s*([\]}])", r"\1", re.sub("['‘’“”]", '"', text))):
        try:
            return _words_of(json.loads(spelling, object_pairs_hook=_Pairs))
        except (ValueError, RecursionError):
            continue
    return None


def _words_of(value: Any) -> list[str] | None:
    """The words of a text, of all items of a list, or of the one key of an object that means actions."""
    if isinstance(value, str):
        return [value] if WORD.match(value) else _words(value)
    if isinstance(value, _Pairs):
        if [key for key, _ in value] in CALL_KEYS:
            return _words_of(value[1][1])
        named = [(key.lower(), inner) for key, inner in value if key.lower() not in ASIDES]
        return _words_of(named[0][1]) if len(named) == 1 and named[0][0] in KEYS else None
    if not isinstance(value, list):
        return None
    parts = [_words_of(item) for item in cast(list[Any], value)]
    return [word for part in parts for word in part or ()] if None not in parts else None
