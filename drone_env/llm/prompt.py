"""Prompts: data files with a version in their names, filled in from what the drone observes.

A prompt that has been published is never changed: a better one is a new file with the next number.
"""

import hashlib
import re
import string
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from drone_env.core.cells import CELL_KINDS
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.models import NAMES, DroneObservation

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FOLDER = Path(__file__).with_name("prompts")
LETTERS = dict(zip(NAMES, ".BTOPxD?C", strict=True))
QUOTED_CHARACTERS = 2000
"""How much of a bad answer is shown to the model again."""


class ChatMessage(TypedDict):
    """One message of a request."""

    role: str
    content: str


@dataclass(frozen=True)
class Prompt:
    """One version of a prompt.

    Attributes:
        id: Name and version, such as `minimal-1`.
        plan: Whether it asks for a whole route.
        system, user, repair: Templates; `repair` takes `reason` alone.
        digest: SHA-256 of the file, whose lines end in LF here, 16 hex digits.
    """

    id: str
    plan: bool
    system: str
    user: str
    repair: str
    digest: str

    @property
    def tells_history(self) -> bool:
        """Whether it has a place for the last steps."""
        return "{history}" in self.user


def prompt_ids() -> list[str]:
    """The ids of all prompts, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*-*.toml"))


@lru_cache
def get_prompt(name: str) -> Prompt:
    """A prompt by its id, or the newest version of a name.

    Raises:
        UnknownNameError: if there is none.
    """
    versions = {found: int(found.rpartition("-")[2]) for found in prompt_ids()}
    named = [found for found in versions if found == name or found.rpartition("-")[0] == name]
    if not named:
        names = {found.rpartition("-")[0] for found in versions}
        raise UnknownNameError("prompt", name, names | set(versions))
    return read_prompt(FOLDER / f"{max(named, key=versions.__getitem__)}.toml")


def read_prompt(path: Path) -> Prompt:
    """A prompt from its file.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a prompt; the message says why.
    """
    # A checkout may have CRLF, which is no other prompt.
    raw = path.read_bytes().replace(b"\r\n", b"\n")
    try:
        data: dict[str, Any] = tomllib.loads(raw.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidValueError(f"{path}: {error}") from None
    kinds: dict[str, type] = {"plan": bool, "system": str, "user": str, "repair": str}
    wrong = [name for name in kinds.keys() | data.keys() if type(data.get(name)) is not kinds.get(name)]
    if wrong:
        raise InvalidValueError(f"{path}: a prompt holds plan (true or false), system, user and repair; see {wrong[0]}")
    for name, known in (("system", VALUES), ("user", VALUES), ("repair", {"reason"})):
        try:
            used = {field for _, field, _, _ in string.Formatter().parse(data[name]) if field is not None}
        except ValueError as error:
            raise InvalidValueError(f"{path}: {name}: {error}") from None
        if used - known:
            raise InvalidValueError(
                f"{path}: {name}: unknown {sorted(used - known)[0]!r}; there are {', '.join(sorted(known))}"
            )
    texts = {name: data[name].strip() for name in ("system", "user", "repair")}
    return Prompt(id=path.stem, plan=data["plan"], digest=hashlib.sha256(raw).hexdigest()[:16], **texts)


def first_messages(prompt: Prompt, episode: Episode, last_steps: Sequence[str] = ()) -> list[ChatMessage]:
    """The messages that ask for the next action, or for the route.

    In tasks with pads every prompt ends with what lies below the drone, which no map shows: that belongs to the version
    of the task, not of the prompt.

    Args:
        prompt: The prompt.
        episode: Where it stands.
        last_steps: The last steps, each in a line.
    """
    observation = DroneObservation.of(episode)
    values = _values(episode.task, observation, last_steps)
    parts = [_fill(prompt.user, values), below_text(episode.task, observation.cell_below)]
    return [
        {"role": "system", "content": _fill(prompt.system, values)},
        {"role": "user", "content": "\n".join(part for part in parts if part)},
    ]


def below_text(task: TaskConfig, kind: str) -> str:
    """What is said of the cell below the drone; nothing where there are no pads, which alone matter there."""
    if not task.pads:
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
    return _fill(prompt.repair, {"reason": reason})


def _fill(template: str, values: dict[str, object]) -> str:
    return re.sub(r"\n{3,}", "\n\n", template.format(**values)).strip()


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
VALUES = {*OBSERVED, "rules", "history"}
"""What a template may name."""


def _values(task: TaskConfig, observation: DroneObservation, last_steps: Sequence[str]) -> dict[str, object]:
    history = "\n".join(["", "Last steps:", *last_steps]) if last_steps else ""
    return {name: of(observation) for name, of in OBSERVED.items()} | {"rules": rules_text(task), "history": history}


def rules_text(task: TaskConfig) -> str:
    """What a step costs and what blocks the way, in words."""
    drain = [f"{units} above a {CELL_KINDS[kind].name}" for kind, units in task.drain if units != 1]
    costs = f"Each step, WAIT too, costs 1 unit of battery{', but ' + ', '.join(drain) if drain else ''}."
    blocked = sorted(CELL_KINDS[kind].name for kind in task.impassable)
    lines = [costs, f"{' and '.join(blocked).capitalize()} cells block the way." if blocked else ""]
    if task.pads and task.charge_rate:
        lines.append(f"WAIT on a charging pad adds {task.charge_rate} units instead.")
    return " ".join(line for line in lines if line)
