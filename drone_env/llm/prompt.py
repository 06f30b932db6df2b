"""Prompts: data files with a version in their names, filled in from the task and from what the drone observes.

A prompt that has been published is never changed: a better one is a new file with the next number. Files of the first
form are filled in by `str.format`, those with `format = 2` by Jinja2, and may include the files in `prompts/parts`.
"""

import hashlib
import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnknownNameError, needs, text_of
from drone_env.files import read_file
from drone_env.llm.answers import MARK
from drone_env.llm.messages import LARGEST, SMALLEST, ChatMessage, Part, picture_part
from drone_env.llm.symbols import PLAIN, Symbols, draw_symbols
from drone_env.llm.values import FIRST_VALUES, TITLES, VALUES, deciding, values_of
from drone_env.models import DroneObservation, Message
from drone_env.toml_text import parse_toml

FOLDER = Path(__file__).with_name("prompts")
MAX_FILE = 1 << 18
QUOTED_CHARACTERS = 2000
"""How much of a bad answer is shown to the model again."""


@dataclass(frozen=True)
class Prompt:
    """One version of a prompt.

    Attributes:
        id: Name and version, such as `minimal-2`.
        plan: Whether it asks for a whole route.
        marks: What may begin the line that holds the answer; none where the answer holds nothing else.
        system, user, repair: Templates; `repair` takes `reason` alone.
        jinja: Whether they are Jinja2's; else they are for `str.format`.
        drawn: Whether it calls actions and kinds of cells by names that are drawn for each map.
        picture: Height in pixels of the picture that it shows of the map; 0 for none.
        names: The values that `system` and `user` take, and the parts that they include; `picture` where it shows one.
        digest: SHA-256 of the file and of what it includes, whose lines end in LF here, 16 hex digits.
        own: The text of the file, where it is none of the package's.
    """

    id: str
    plan: bool
    marks: tuple[str, ...]
    system: str
    user: str
    repair: str
    jinja: bool
    drawn: bool
    picture: int
    names: frozenset[str]
    digest: str
    own: str | None = None

    @property
    def tells_history(self) -> bool:
        """Whether it has a place for the last steps."""
        return "history" in self.names

    def symbols(self, task: TaskConfig, seed: int) -> Symbols:
        """What it calls actions and kinds of cells over a map."""
        return draw_symbols(task, seed) if self.drawn else PLAIN


class PromptFile(Message):
    """What the file of a prompt holds."""

    format: Literal[2] | None = None
    plan: bool
    marks: tuple[Annotated[str, Field(pattern=rf"^({MARK})$")], ...] = Field(default=(), strict=False)
    symbols: Literal["drawn"] | None = None
    picture: int | None = Field(default=None, ge=SMALLEST, le=LARGEST)
    system: str
    user: str
    repair: str


def prompt_ids() -> list[str]:
    """The ids of all prompts, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*-*.toml"))


def get_prompt(name: str) -> Prompt:
    """A prompt by its id, the newest version of a name, or one of your own by its file, which ends in `.toml`.

    Raises:
        UnknownNameError: if there is none of this name.
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a prompt; the message says why.
    """
    if name.endswith(".toml"):
        return read_prompt(Path(name))
    versions = {found: int(found.rpartition("-")[2]) for found in prompt_ids()}
    named = [found for found in versions if found == name or found.rpartition("-")[0] == name]
    if not named:
        names = {found.rpartition("-")[0] for found in versions}
        raise UnknownNameError("prompt", name, names | set(versions) | {"FILE.toml"})
    return read_prompt(FOLDER / f"{max(named, key=versions.__getitem__)}.toml")


def read_prompt(path: Path) -> Prompt:
    """A prompt from its file.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a prompt; the message says why.
    """
    try:
        return parse_prompt(str(path), text_of_file(path), FOLDER not in path.parents)
    except UnicodeDecodeError as error:
        raise InvalidValueError(f"{path}: {error}") from None


def text_of_file(path: Path) -> str:
    """What a file holds, whose lines end in LF here: a checkout may have CRLF, which is no other prompt."""
    return read_file(path, MAX_FILE).replace(b"\r\n", b"\n").decode()


@lru_cache(maxsize=64)
def parse_prompt(path: str, text: str, own: bool) -> Prompt:
    """A prompt from the text of its file.

    Args:
        path: Where it is from: its id is the file's name.
        text: What the file holds.
        own: Whether it is none of the package's.

    Raises:
        InvalidValueError: if it is not a prompt; the message says why.
    """
    try:
        data = PromptFile.model_validate(parse_toml(text))
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    except ValidationError as error:
        raise InvalidValueError(f"{path} is not a prompt: {text_of(error)}") from None
    jinja = data.format == 2
    if own and not jinja:
        raise InvalidValueError(f"{path}: a prompt of your own has format = 2")
    if own and Path(path).stem in prompt_ids():
        raise InvalidValueError(f"{path}: the package has a prompt of this name: give it another one")
    names_of, names, parts = (_jinja_names if jinja else _format_names), set[str](), _parts() if jinja else {}
    texts = data.model_dump(include={"system", "user", "repair"})
    values = VALUES if jinja else FIRST_VALUES
    for part, known in (("system", values), ("user", values), ("repair", {"reason"})):
        used = names_of(f"{path}: {part}", texts[part])
        if used - known - parts.keys():
            unknown = sorted(used - known - parts.keys())[0]
            raise InvalidValueError(
                f"{path}: {part}: unknown {unknown!r}; there are {', '.join(sorted(known | parts.keys()))}"
            )
        names |= used - {"reason"}
    if data.symbols and data.picture:
        raise InvalidValueError(f"{path}: pictures name their figures plainly: give symbols without picture")
    if data.symbols and "grid" in names and "legend" not in names:
        raise InvalidValueError(f"{path}: the letters of the grid are drawn, too: {{{{ legend }}}} says what they are")
    names |= {"picture"} if data.picture else set()
    whole = "".join([text, *(parts[name] for name in sorted(names & parts.keys()))])
    return Prompt(
        id=Path(path).stem,
        plan=data.plan,
        marks=data.marks,
        jinja=jinja,
        drawn=data.symbols is not None,
        picture=data.picture or 0,
        names=frozenset(names),
        digest=hashlib.sha256(whole.encode()).hexdigest()[:16],
        own=text if own else None,
        **{name: template.strip() for name, template in texts.items()},
    )


def _format_names(where: str, template: str) -> set[str]:
    try:
        return {field for _, field, _, _ in string.Formatter().parse(template) if field is not None}
    except ValueError as error:
        raise InvalidValueError(f"{where}: {error}") from None


def _jinja_names(where: str, template: str) -> set[str]:
    with needs("llm"):
        from jinja2 import TemplateError, meta

    try:
        tree = _environment().parse(template)
    except TemplateError as error:
        raise InvalidValueError(f"{where}: {error}") from None
    included = {str(name) for name in meta.find_referenced_templates(tree)}
    names = meta.find_undeclared_variables(tree) | included
    return names.union(*(_jinja_names(where, _parts()[name]) for name in included & _parts().keys()))


@lru_cache(maxsize=1)
def _parts() -> dict[str, str]:
    """What prompts may include, by file name."""
    return {path.name: text_of_file(path) for path in FOLDER.glob("parts/*.j2")}


@lru_cache(maxsize=1)
def _environment() -> Any:
    from jinja2 import DictLoader, StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    # In a sandbox: whoever checks the run of somebody else fills in that one's prompt.
    return ImmutableSandboxedEnvironment(
        loader=DictLoader(_parts()),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


@lru_cache(maxsize=64)
def _template(text: str) -> Any:
    return _environment().from_string(text)


def first_messages(prompt: Prompt, episode: Episode, last_steps: Sequence[str] = ()) -> list[ChatMessage]:
    """The messages that ask for the next action, or for the route.

    Where it matters every prompt ends with what lies below the drone, which no map shows: that belongs to the task.

    Args:
        prompt: The prompt.
        episode: Where it stands.
        last_steps: The last steps, each in a line.

    Raises:
        InvalidValueError: if a prompt of one's own cannot be filled in.
    """
    system, user = first_texts(prompt, episode, last_steps)
    content: str | list[Part] = user
    if prompt.picture:
        content = [picture_part(episode, prompt.picture), {"type": "text", "text": user}]
    return [{"role": "system", "content": system}, {"role": "user", "content": content}]


def first_texts(prompt: Prompt, episode: Episode, last_steps: Sequence[str] = ()) -> tuple[str, str]:
    """The texts of the system and of the user in `first_messages`."""
    task, symbols = episode.task, prompt.symbols(episode.task, episode.seed)
    observation = DroneObservation.of(episode)
    values = values_of(task, observation, last_steps, symbols)
    system = [symbols.meaning, symbols.called(_fill(prompt, prompt.system, values))]
    below = below_text(prompt, task, observation.cell_below)
    user = [symbols.called(text) for text in (_fill(prompt, prompt.user, values), below)]
    return "\n".join(filter(None, system)), "\n".join(filter(None, user))


def below_text(prompt: Prompt, task: TaskConfig, kind: str) -> str:
    """What is said of the cell below the drone; nothing where it decides nothing. The first prompts tell only pads."""
    if not task.pads and not (prompt.jinja and any(deciding(task))):
        return ""
    return f"Below the drone: {'charging pad' if kind == 'pad' else kind}"


def repair_messages(
    prompt: Prompt, asked: Sequence[ChatMessage], answer: str, reason: str, symbols: Symbols = PLAIN
) -> list[ChatMessage]:
    """The messages that ask once more, after an answer that could not be used."""
    return [
        *asked,
        {"role": "assistant", "content": answer[:QUOTED_CHARACTERS]},
        {"role": "user", "content": repair_text(prompt, reason, symbols)},
    ]


def repair_text(prompt: Prompt, reason: str, symbols: Symbols = PLAIN) -> str:
    """What is said about an answer that could not be used."""
    # The reason quotes the model: an UP that it said is told as it was.
    text = _fill(prompt, prompt.repair, {"reason": reason})
    return reason.join(symbols.called(around) for around in text.split(reason))


def _fill(prompt: Prompt, template: str, values: Mapping[str, object]) -> str:
    if not prompt.jinja:
        return re.sub(r"\n{3,}", "\n\n", template.format(**values)).strip()
    try:
        return re.sub(r"\n{3,}", "\n\n", _template(template).render(values)).strip()
    except Exception as error:
        # A template of one's own can go wrong in as many ways as a program.
        raise InvalidValueError(f"prompt {prompt.id} cannot be filled in: {error}") from error


def untold(prompt: Prompt, task: TaskConfig) -> list[str]:
    """What decides the best flight over maps of a task and has no place in a prompt, in words.

    A prompt of one's own tells the rules if it includes the part that says them. The cell below is always told.
    """
    one, alone = task.deliveries == 1, task.uniform and task.battery_capacity == task.max_steps
    needed: list[tuple[str, list[set[str]]]] = [
        ("the score and what ends a flight", [{name} for name in _parts() if name.startswith("rules-")]),
        ("where the drone is", [{"x", "y"}, {"grid"}, {"picture"}]),
        ("the units of battery", [{"battery_steps"}]),
        ("the steps taken", [{"step"}, {"steps_left"}, *([{"battery_steps"}] if alone else [])]),
        ("all parcels", [{"parcels"}, {"grid"}, {"picture"}, *([{"target"}] if one else [])]),
        *(
            (TITLES[kind].lower(), [{"terrain"}, {"grid"}, {"picture"}, {TITLES[kind].split()[-1].lower()}])
            for kind in deciding(task)
        ),
    ]
    return [words for words, ways in needed if not any(way <= prompt.names for way in ways)]
