"""Prompts: data files with a version in their names, filled in from the task and from what the drone observes.

A prompt that has been published is never changed: a better one is a new file with the next number. Files of the first
form are filled in by `str.format`, those with `format = 2` by Jinja2, and may include the files in `prompts/parts`.
"""

import hashlib
import re
import string
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError
from typing_extensions import TypedDict

from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnknownNameError, needs, text_of
from drone_env.llm.answers import MARK
from drone_env.models import NAMES, DroneObservation, Message

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FOLDER = Path(__file__).with_name("prompts")
LETTERS = dict(zip(NAMES, ".BTOPxD?C", strict=True))
QUOTED_CHARACTERS = 2000
"""How much of a bad answer is shown to the model again."""
OWN = {Cell.DELIVERY: "parcel to deliver", Cell.DELIVERED: "delivered parcel", Cell.PAD: "charging pad"}
"""What prompts call kinds of cells whose own names say too little."""
TITLES = {Cell.BUILDING: "Buildings", Cell.TREE: "Trees", Cell.OBSTACLE: "Obstacles", Cell.PAD: "Charging pads"}


class ChatMessage(TypedDict):
    """One message of a request."""

    role: str
    content: str


@dataclass(frozen=True)
class Prompt:
    """One version of a prompt.

    Attributes:
        id: Name and version, such as `minimal-2`.
        plan: Whether it asks for a whole route.
        marks: What may begin the line that holds the answer; none where the answer holds nothing else.
        system, user, repair: Templates; `repair` takes `reason` alone.
        jinja: Whether they are Jinja2's; else they are for `str.format`.
        names: The values that `system` and `user` take, and the parts that they include.
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
    names: frozenset[str]
    digest: str
    own: str | None = None

    @property
    def tells_history(self) -> bool:
        """Whether it has a place for the last steps."""
        return "history" in self.names


class PromptFile(Message):
    """What the file of a prompt holds."""

    format: Literal[2] | None = None
    plan: bool
    marks: tuple[Annotated[str, Field(pattern=rf"^({MARK})$")], ...] = Field(default=(), strict=False)
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
    return path.read_bytes().replace(b"\r\n", b"\n").decode()


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
        data = PromptFile.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
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
            raise InvalidValueError(f"{path}: {part}: unknown {unknown!r}; there are {', '.join(sorted(known))}")
        names |= used - {"reason"}
    whole = "".join([text, *(parts[name] for name in sorted(names & parts.keys()))])
    return Prompt(
        id=Path(path).stem,
        plan=data.plan,
        marks=data.marks,
        jinja=jinja,
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
    observation = DroneObservation.of(episode)
    values = _values(episode.task, observation, last_steps)
    parts = [_fill(prompt, prompt.user, values), below_text(prompt, episode.task, observation.cell_below)]
    return [
        {"role": "system", "content": _fill(prompt, prompt.system, values)},
        {"role": "user", "content": "\n".join(part for part in parts if part)},
    ]


def below_text(prompt: Prompt, task: TaskConfig, kind: str) -> str:
    """What is said of the cell below the drone; nothing where it decides nothing. The first prompts tell only pads."""
    if not task.pads and not (prompt.jinja and any(_deciding(task))):
        return ""
    return f"Below the drone: {'charging pad' if kind == 'pad' else kind}"


def repair_messages(prompt: Prompt, asked: Sequence[ChatMessage], answer: str, reason: str) -> list[ChatMessage]:
    """The messages that ask once more, after an answer that could not be used."""
    return [
        *asked,
        {"role": "assistant", "content": answer[:QUOTED_CHARACTERS]},
        {"role": "user", "content": repair_text(prompt, reason)},
    ]


def repair_text(prompt: Prompt, reason: str) -> str:
    """What is said about an answer that could not be used."""
    return _fill(prompt, prompt.repair, {"reason": reason})


def _fill(prompt: Prompt, template: str, values: Mapping[str, object]) -> str:
    if not prompt.jinja:
        return re.sub(r"\n{3,}", "\n\n", template.format(**values)).strip()
    try:
        return re.sub(r"\n{3,}", "\n\n", _template(template).render(values)).strip()
    except Exception as error:
        # A template of one's own can go wrong in as many ways as a program.
        raise InvalidValueError(f"prompt {prompt.id} cannot be filled in: {error}") from error


def _places(observation: DroneObservation, kind: str) -> str:
    found = [
        f"({x}, {y})" for y, line in enumerate(observation.cell_types) for x, name in enumerate(line) if name == kind
    ]
    return " ".join(found) or "none"


def _target(observation: DroneObservation) -> str:
    target = observation.current_target
    return "none" if target is None else f"({target[0]}, {target[1]})"


OBSERVED: dict[str, Callable[[DroneObservation], object]] = {
    "x": lambda seen: seen.drone_x,
    "y": lambda seen: seen.drone_y,
    "battery_percent": lambda seen: round(100 * seen.battery),
    "battery_steps": lambda seen: seen.battery_steps_remaining,
    "target": _target,
    "distance": lambda seen: round(seen.distance_to_target or 0),
    "deliveries_done": lambda seen: seen.deliveries_done,
    "deliveries_total": lambda seen: seen.deliveries_total,
    "step": lambda seen: seen.step_count,
    "steps_left": lambda seen: seen.max_steps - seen.step_count,
    "max_steps": lambda seen: seen.max_steps,
    "width": lambda seen: seen.grid_width,
    "height": lambda seen: seen.grid_height,
    "grid": lambda seen: "\n".join(" ".join(LETTERS[name] for name in line) for line in seen.cell_types),
    "parcels": lambda seen: _places(seen, "delivery"),
    "buildings": lambda seen: _places(seen, "building"),
    "trees": lambda seen: _places(seen, "tree"),
    "obstacles": lambda seen: _places(seen, "obstacle"),
    "pads": lambda seen: _places(seen, "pad"),
}
VALUES = {*OBSERVED, "history", "task", "drains", "impassable", "terrain"}
"""What a template may name."""
FIRST_VALUES = {*OBSERVED, "history", "rules"}
"""What one of the first form may name."""


def _values(task: TaskConfig, observation: DroneObservation, last_steps: Sequence[str]) -> dict[str, object]:
    history = "\n".join(["", "Last steps:", *last_steps]) if last_steps else ""
    deciding = set(_deciding(task))
    return {name: of(observation) for name, of in OBSERVED.items()} | {
        "rules": rules_text(task),
        "history": history,
        "task": task,
        "drains": [(_name(kind), units) for kind, units in task.drain if units != 1],
        "impassable": sorted(map(_name, task.impassable)),
        "terrain": [
            (title, _places(observation, CELL_KINDS[kind].name), kind in deciding) for kind, title in TITLES.items()
        ],
    }


def _name(kind: Cell) -> str:
    return OWN.get(kind, CELL_KINDS[kind].name)


def _deciding(task: TaskConfig) -> Iterator[Cell]:
    """The kinds of terrain whose places decide how to fly over maps of a task."""
    for kind, count in task.cell_counts().items():
        charges = kind is Cell.PAD and task.charge_rate > 0
        if count and (charges or kind in task.impassable or dict(task.drain).get(kind, 1) != 1):
            yield kind


def untold(prompt: Prompt, task: TaskConfig) -> list[str]:
    """What decides the best flight over maps of a task and has no place in a prompt, in words.

    A prompt of one's own tells the rules if it includes the part that says them. The cell below is always told.
    """
    one, alone = task.deliveries == 1, task.uniform and task.battery_capacity == task.max_steps
    needed: list[tuple[str, list[set[str]]]] = [
        ("the score and what ends a flight", [{name} for name in _parts() if name.startswith("rules-")]),
        ("where the drone is", [{"x", "y"}, {"grid"}]),
        ("the units of battery", [{"battery_steps"}]),
        ("the steps taken", [{"step"}, {"steps_left"}, *([{"battery_steps"}] if alone else [])]),
        ("all parcels", [{"parcels"}, {"grid"}, *([{"target"}] if one else [])]),
        *(
            (TITLES[kind].lower(), [{"terrain"}, {"grid"}, {TITLES[kind].split()[-1].lower()}])
            for kind in _deciding(task)
        ),
    ]
    return [words for words, ways in needed if not any(way <= prompt.names for way in ways)]


def rules_text(task: TaskConfig) -> str:
    """What a step costs and what blocks the way, in the words of the first prompts."""
    drain = [f"{units} above a {CELL_KINDS[kind].name}" for kind, units in task.drain if units != 1]
    costs = f"Each step, WAIT too, costs 1 unit of battery{', but ' + ', '.join(drain) if drain else ''}."
    blocked = sorted(CELL_KINDS[kind].name for kind in task.impassable)
    lines = [costs, f"{' and '.join(blocked).capitalize()} cells block the way." if blocked else ""]
    if task.pads and task.charge_rate:
        lines.append(f"WAIT on a charging pad adds {task.charge_rate} units instead.")
    return " ".join(line for line in lines if line)
