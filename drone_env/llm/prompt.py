"""Prompts: TOML files with a version in their names, whose Jinja2 templates show a task and an observation.

A published prompt never changes: a better one is a new file with the next number. Templates may include the files in
`prompts/parts`.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnknownNameError, needs, text_of
from drone_env.files import read_file
from drone_env.llm.answers import MARK, Answer, Reading, read_answer
from drone_env.llm.content import (
    LARGEST,
    SMALLEST,
    VALUES,
    ChatMessage,
    Part,
    deciding,
    picture_part,
    values_of,
)
from drone_env.models import DroneObservation, Message
from drone_env.toml_text import parse_toml

FOLDER = Path(__file__).with_name("prompts")
MAX_FILE = 1 << 18
QUOTED_CHARACTERS = 2000
"""The model sees this much of an unusable answer again."""


class PromptFile(Message):
    """The fields of a prompt file."""

    format: Literal[1]
    plan: bool = Field(description="Whether it asks for a whole route.")
    marks: tuple[Annotated[str, Field(pattern=rf"^({MARK})$")], ...] = Field(
        default=(), strict=False, description="What can start the line with the answer; empty if there is only that."
    )
    picture: int | None = Field(default=None, ge=SMALLEST, le=LARGEST, description="Height in pixels.")
    system: str = Field(description="A template.")
    user: str = Field(description="A template.")
    repair: str = Field(description="A template; it takes `reason` alone.")


class Prompt(PromptFile):
    """One version of a prompt."""

    id: str = Field(description="Name and version, such as `minimal-2`.")
    names: frozenset[str] = Field(description="The values that its templates use, and the parts they include.")
    digest: str = Field(description="SHA-256 of the file and its parts, with LF line ends, 16 hex digits.")
    own: str | None = Field(description="The text of a file that is not part of the package.")

    def read_answer(self, answer: Answer) -> Reading:
        """Understand an answer."""
        return read_answer(answer, self.plan, self.marks)


def prompt_ids() -> list[str]:
    """The ids of all prompts, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*-*.toml"))


def get_prompt(name: str) -> Prompt:
    """A prompt by its id, the newest version of a name, or your own by its file, which ends in `.toml`.

    Raises:
        UnknownNameError: if there is no prompt of this name.
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a prompt; the message says why.
    """
    if name.endswith(".toml"):
        return read_prompt(Path(name))
    named = {found: found.rpartition("-")[0] for found in prompt_ids()}
    versions = [found for found in named if name in (found, named[found])]
    if not versions:
        raise UnknownNameError("prompt", name, {*named, *named.values(), "FILE.toml"})
    return read_prompt(FOLDER / f"{max(versions, key=lambda found: int(found.rpartition('-')[2]))}.toml")


def read_prompt(path: Path) -> Prompt:
    """Read a prompt from its file.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a prompt; the message says why.
    """
    try:
        return parse_prompt(str(path), text_of_file(path), FOLDER not in path.parents)
    except UnicodeDecodeError as error:
        raise InvalidValueError(f"{path}: {error}") from None


def text_of_file(path: Path) -> str:
    """The text of a file with LF line ends: a checkout with CRLF has the same prompts."""
    return read_file(path, MAX_FILE).replace(b"\r\n", b"\n").decode()


@lru_cache(maxsize=64)
def parse_prompt(path: str, text: str, own: bool) -> Prompt:
    """Parse the text of a prompt file.

    Args:
        path: The file; its name is the id of the prompt.
        text: Its text.
        own: Whether it is not part of the package.

    Raises:
        InvalidValueError: if it is not a prompt; the message says why.
    """
    try:
        data = PromptFile.model_validate(parse_toml(text))
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    except ValidationError as error:
        raise InvalidValueError(f"{path} is not a prompt: {text_of(error)}") from None
    if own and Path(path).stem in prompt_ids():
        raise InvalidValueError(f"{path}: the package has a prompt of this name: give it another one")
    names, parts = set[str](), _parts()
    texts = data.model_dump(include={"system", "user", "repair"})
    for part, known in (("system", VALUES), ("user", VALUES), ("repair", {"reason"})):
        used = _names(f"{path}: {part}", texts[part])
        if unknown := sorted(used - known - parts.keys()):
            allowed = ", ".join(sorted(known | parts.keys()))
            raise InvalidValueError(f"{path}: {part}: unknown {unknown[0]!r}; there are {allowed}")
        names |= used - {"reason"}
    whole = "".join([text, *(parts[name] for name in sorted(names & parts.keys()))])
    digest = hashlib.sha256(whole.encode()).hexdigest()[:16]
    fields = data.model_dump() | {name: template.strip() for name, template in texts.items()}
    return Prompt(**fields, id=Path(path).stem, names=frozenset(names), digest=digest, own=text if own else None)


def _names(where: str, template: str) -> set[str]:
    """The names that a template uses, itself or in a part that it includes, and those of the parts."""
    with needs("llm"):
        from jinja2 import TemplateError, meta

    try:
        tree = _environment().parse(template)
    except TemplateError as error:
        raise InvalidValueError(f"{where}: {error}") from None
    included = {str(name) for name in meta.find_referenced_templates(tree)}
    names = meta.find_undeclared_variables(tree) | included
    return names.union(*(_names(where, _parts()[name]) for name in included & _parts().keys()))


@lru_cache(maxsize=1)
def _parts() -> dict[str, str]:
    """The texts that prompts may include, by file name."""
    return {path.name: text_of_file(path) for path in FOLDER.glob("parts/*.j2")}


@lru_cache(maxsize=1)
def _environment() -> Any:
    from jinja2 import DictLoader, StrictUndefined
    from jinja2.sandbox import ImmutableSandboxedEnvironment

    # Verifying a run from elsewhere renders a prompt from elsewhere.
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

    Args:
        prompt: The prompt.
        episode: The episode in its current state.
        last_steps: The last steps, one line each.

    Raises:
        InvalidValueError: if the template of your own prompt cannot be rendered.
    """
    system, user = first_texts(prompt, episode, last_steps)
    content: str | list[Part] = user
    if prompt.picture:
        content = [picture_part(episode, prompt.picture), {"type": "text", "text": user}]
    return [{"role": "system", "content": system}, {"role": "user", "content": content}]


def first_texts(prompt: Prompt, episode: Episode, last_steps: Sequence[str] = ()) -> tuple[str, str]:
    """The texts of the system and of the user in `first_messages`."""
    task, obs = episode.task, DroneObservation.of(episode)
    values = values_of(task, obs, last_steps, prompt.names)
    user = [_render(prompt, prompt.user, values), below_text(task, obs.cell_below)]
    return _render(prompt, prompt.system, values), "\n".join(filter(None, user))


def below_text(task: TaskConfig, kind: str) -> str:
    """The line about the cell below the drone, which no map shows; empty if it does not matter for the task."""
    if not task.pads and not any(deciding(task)):
        return ""
    return f"Below the drone: {'charging pad' if kind == 'pad' else kind}"


def repair_messages(prompt: Prompt, asked: Sequence[ChatMessage], answer: str, reason: str) -> list[ChatMessage]:
    """The messages that ask once more, after an unusable answer."""
    return [
        *asked,
        {"role": "assistant", "content": answer[:QUOTED_CHARACTERS]},
        {"role": "user", "content": repair_text(prompt, reason)},
    ]


def repair_text(prompt: Prompt, reason: str) -> str:
    """What the model reads about its unusable answer."""
    return _render(prompt, prompt.repair, {"reason": reason})


def _render(prompt: Prompt, template: str, values: Mapping[str, object]) -> str:
    try:
        return re.sub(r"\n{3,}", "\n\n", _template(template).render(values)).strip()
    except Exception as error:
        # Your own template can fail in as many ways as a program.
        raise InvalidValueError(f"prompt {prompt.id} cannot be filled in: {error}") from error
