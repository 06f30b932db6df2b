"""Prompts: versioned TOML files whose Jinja2 templates show a task and the state of an episode.

A published prompt never changes: an improved one is a new file with the next number. Templates may include the files
in `prompts/parts`.
"""

import hashlib
import re
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, StringConstraints, ValidationError

from drone_env.core.actions import ACTION_OFFSETS, Action, Event
from drone_env.core.cells import CELL_KINDS, LETTERS, Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, MissingPackageError, UnknownNameError, needs, text_of
from drone_env.files import read_file
from drone_env.llm.answers import MARK, ChatMessage
from drone_env.models import StrictModel
from drone_env.toml_text import parse_toml

if TYPE_CHECKING:
    from drone_env.planning.stops import NextStop

FOLDER = Path(__file__).with_name("prompts")
MAX_FILE = 1 << 18
QUOTED_CHARACTERS = 2000
"""Length of the unusable answer that the repair request quotes."""
NO_TEXT = "(no text)"
"""What it quotes of an empty answer."""
LABELS = {Cell.DELIVERY: "parcel to deliver", Cell.DELIVERED: "delivered parcel", Cell.PAD: "charging pad"}
"""Names in prompts that differ from the names of the cells."""
TITLES = {Cell.BUILDING: "Buildings", Cell.TREE: "Trees", Cell.OBSTACLE: "Obstacles", Cell.PAD: "Charging pads"}
COMPASS_PADS = 5
"""The largest number of charging pads that the compass shows."""
CELL_LETTERS = list(LETTERS.values())


Template = Annotated[str, StringConstraints(strip_whitespace=True)]


class Prompt(StrictModel):
    """One version of a prompt: the fields of its file, and what identifies it."""

    id: str = Field(description="Name and version, such as `minimal-2`.")
    digest: str = Field(description="SHA-256 of the file and the parts that it includes, 16 hex digits.")
    own: str | None = Field(description="The text of a file that is not part of the package.")
    format: Literal[1]
    plan: bool = Field(description="Whether it asks for a whole route.")
    stop: bool = Field(default=False, description="Whether it asks for the next stop: see `planning.stops.next_stops`.")
    marks: tuple[Annotated[str, Field(pattern=rf"^({MARK})$")], ...] = Field(
        default=(), strict=False, description="What can start the line with the answer; empty for a bare answer."
    )
    system: Template = Field(default="", description="A template; without text, no system message is sent.")
    user: Template = Field(description="A template.")
    repair: Template = Field(description="A template with the one value `reason`.")

    def messages(self, episode: Episode) -> list[ChatMessage]:
        """The system message, if it has text, and the user message that ask for the next action, or for the route.

        Args:
            episode: The episode in its current state.

        Raises:
            InvalidValueError: if the template of your own prompt cannot be rendered.
        """
        values = _values(episode)
        user = [self._render(self.user, values), "" if self.stop else below_text(episode)]
        texts = {"system": self._render(self.system, values), "user": "\n".join(filter(None, user))}
        return [{"role": role, "content": text} for role, text in texts.items() if text or role == "user"]

    def repair_messages(self, answer: str, reason: str) -> list[ChatMessage]:
        """The messages that follow an unusable answer: the answer, and why it is unusable."""
        return [
            # Some endpoints reject an empty message.
            {"role": "assistant", "content": answer[:QUOTED_CHARACTERS] if answer.strip() else NO_TEXT},
            {"role": "user", "content": self.repair_text(reason)},
        ]

    def repair_text(self, reason: str) -> str:
        """The text that explains to the model why its answer is unusable."""
        return self._render(self.repair, {"reason": reason})

    def _render(self, template: str, values: Mapping[str, object]) -> str:
        try:
            return re.sub(r"\n{3,}", "\n\n", _template(template).render(values)).strip()
        except MissingPackageError:
            raise
        except Exception as error:  # a template can fail in as many ways as a program
            names = ", ".join(values)
            raise InvalidValueError(f"prompt {self.id} cannot be rendered: {error}; values: {names}") from error


def prompt_ids() -> list[str]:
    """The ids of all prompts, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*-*.toml"))


def prompt_names() -> list[str]:
    """The names of all prompts, without their versions, sorted."""
    return sorted({id_.rpartition("-")[0] for id_ in prompt_ids()})


def get_prompt(name: str) -> Prompt:
    """A prompt by its id, the newest version of a name, or your own by its file, which ends in `.toml`.

    Raises:
        UnknownNameError: if there is no prompt of this name.
        OSError: if the file cannot be read.
        InvalidValueError: if the file is not a prompt.
    """
    if name.endswith(".toml"):
        return read_prompt(Path(name))
    versions = [id_ for id_ in prompt_ids() if name in (id_, id_.rpartition("-")[0])]
    if not versions:
        raise UnknownNameError("prompt", name, [*prompt_ids(), *prompt_names(), "FILE.toml"])
    return read_prompt(FOLDER / f"{max(versions, key=lambda id_: int(id_.rpartition('-')[2]))}.toml")


def tools_prompt() -> Prompt:
    """The prompt of flights by tool calls: see `TextEpisode.fly` and `TextEpisode.goto`."""
    return read_prompt(FOLDER / "tools" / "fly-4.toml")


def read_prompt(path: Path) -> Prompt:
    """Read a prompt from its file.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a prompt.
    """
    try:
        text = read_file(path, MAX_FILE).decode().replace("\r\n", "\n")
        return parse_prompt(str(path), text, FOLDER not in path.parents)
    except UnicodeDecodeError as error:
        raise InvalidValueError(f"{path}: {error}") from None


@lru_cache(maxsize=64)
def parse_prompt(path: str, text: str, own: bool) -> Prompt:
    """Parse the text of a prompt file.

    Args:
        path: Its file, which gives the id.
        text: Its text.
        own: Whether it is not part of the package.

    Raises:
        InvalidValueError: if it is not a prompt.
    """
    digest = hashlib.sha256(_with_parts(text).encode()).hexdigest()[:16]
    identity = {"id": Path(path).stem, "digest": digest, "own": text if own else None}
    try:
        prompt = Prompt.model_validate({**parse_toml(text), **identity})
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    except ValidationError as error:
        raise InvalidValueError(f"{path} is not a prompt: {text_of(error)}") from None
    if own:  # one flight shows whether its templates can be rendered
        prompt.messages(Episode("easy", seed=0))
        prompt.repair_text("")
    return prompt


@lru_cache(maxsize=1)
def _parts() -> dict[str, str]:
    """The texts that prompts may include, by file name."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("parts/*.j2"))}


def _with_parts(text: str) -> str:
    """The text, and behind it those of the parts that it names, and that these name in turn."""
    return text + "".join(_with_parts(part) for name, part in _parts().items() if name in text)


@lru_cache(maxsize=1)
def _environment() -> Any:
    with needs("llm"):
        from jinja2 import DictLoader, StrictUndefined
        from jinja2.sandbox import ImmutableSandboxedEnvironment

    # A run folder from somebody else contains a prompt from somebody else.
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


def _values(episode: Episode) -> dict[str, object]:
    """The values that a template can use."""
    task, cells, target = episode.task, episode.grid(), episode.target
    x, y = episode.position
    deciding = _deciding(task)
    return {
        "x": x,
        "y": y,
        "battery_percent": round(100 * episode.battery),
        "battery_steps": episode.battery_units,
        "target": "none" if target is None else str(target),
        "distance": episode.distance_to_target or 0,
        "deliveries_done": episode.deliveries_done,
        "deliveries_total": task.deliveries,
        "step": episode.steps,
        "steps_left": task.max_steps - episode.steps,
        "max_steps": task.max_steps,
        "width": task.width,
        "height": task.height,
        "parcels": _places(cells == Cell.DELIVERY),
        "grid": "\n".join(" ".join(map(CELL_LETTERS.__getitem__, row)) for row in cells.tolist()),
        "task": task,
        "drains": [(_label(kind), units) for kind, units in task.drain if units != 1],
        "impassable": sorted(map(_label, task.impassable)),
        "terrain": [(title, _places(cells == kind), kind in deciding) for kind, title in TITLES.items()],
        "compass": partial(_compass, episode),  # takes milliseconds
        "stops": partial(stops_of, episode),
        "came": _came(episode),
    }


def _places(among: npt.NDArray[np.bool_]) -> str:
    """The coordinates of cells, row by row."""
    return " ".join(f"({x}, {y})" for y, x in np.argwhere(among).tolist()) or "none"


def _compass(episode: Episode) -> str:
    """One line for each neighbouring cell, and for the cheapest way to each parcel and to the nearest pads."""
    from drone_env.planning.paths import cheapest_ways  # compiles

    task, grid = episode.task, episode.grid()
    (x, y), here = episode.position, episode.cell
    units, first = cheapest_ways(task, grid.reshape(-1), here)
    grid[y, x] = episode.under
    lines: list[str] = []
    for action, (dx, dy) in ACTION_OFFSETS.items():
        if action is not Action.WAIT:
            inside = 0 <= x + dx < task.width and 0 <= y + dy < task.height
            lines.append(f"{action.name} {CELL_KINDS[grid[y + dy, x + dx]].name if inside else 'edge'}")
    for label, kind, most in (("pad", Cell.PAD, COMPASS_PADS), ("parcel", Cell.DELIVERY, None)):
        cells = [cell for cell in np.flatnonzero(grid == kind).tolist() if units[cell] >= 0]
        for cell in sorted(cells, key=units.__getitem__)[:most]:
            dx, dy = cell % task.width - x, cell // task.width - y
            where = f"{'left' if dx < 0 else 'right'} {abs(dx)} {'up' if dy < 0 else 'down'} {abs(dy)}"
            way = Action(first[cell]).name if cell != here else "WAIT"
            lines.append(f"{label} {where} cost {units[cell]} via {way}")
    return "\n".join(lines)


def stops_of(episode: Episode) -> "list[NextStop]":
    """The stops that an answer can name."""
    from drone_env.planning.stops import next_stops  # compiles

    return next_stops(episode)


def ways_of(episode: Episode) -> dict[str, list[Action]]:
    """The actions of the way to each stop that an answer can name, by label."""
    return {stop.label: stop.actions for stop in stops_of(episode)}


def stops_text(episode: Episode) -> str:
    """One line for each stop in reach."""
    return _template('{% include "stops-1.j2" %}').render(stops=partial(stops_of, episode)).strip()


def _came(episode: Episode) -> str:
    """The action that leads back to the previous cell; empty if the last step was no move."""
    last = episode.last_step
    if last is None or last.event in (Event.WALL, Event.BLOCKED) or last.action is Action.WAIT:
        return ""
    return Action(last.action ^ 1).name


def _label(kind: Cell) -> str:
    return LABELS.get(kind, CELL_KINDS[kind].name)


@lru_cache(maxsize=64)
def _deciding(task: TaskConfig) -> frozenset[Cell]:
    """The kinds of terrain that affect the best flight over maps of a task."""
    there = {kind for kind, count in task.cell_counts().items() if count}
    special = {kind for kind, units in task.drain if units != 1} | task.impassable
    return frozenset(there & (special | {Cell.PAD} if task.charge_rate > 0 else special))


def below_text(episode: Episode) -> str:
    """The line about the cell below the drone, which no map shows; empty if it does not matter for the task."""
    if not episode.task.pads and not _deciding(episode.task):
        return ""
    kind = Cell(episode.under)
    return f"Below the drone: {'charging pad' if kind is Cell.PAD else CELL_KINDS[kind].name}"
