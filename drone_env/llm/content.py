"""What prompts show of an episode: values as text, the words for actions and cells, and the map as a picture.

The words are plain, or drawn for each map. Drawn words are of no use to a model that knows UP and buildings by heart:
it has to read what the prompt says about them.

A picture is named by its contents until it is sent, also in transcripts: a PNG takes 200 KB, and a flight has one for
each step. The pixels depend on the version of Pillow; the contents do not.
"""

import base64
import hashlib
import io
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple
from urllib.parse import parse_qsl, urlencode

from typing_extensions import TypedDict

from drone_env.core.actions import ACTION_OFFSETS, Action
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.models import NAMES, DroneObservation

SMALLEST, LARGEST = 256, 2048
"""Heights of pictures in pixels: details vanish on smaller ones, and every endpoint shrinks larger ones."""
SHOWS = "drone-env:picture?"
"""Prefix of the addresses of pictures that are not drawn yet; their contents follow."""
DRAWN = "data:image/png;base64,"
LABELS = {Cell.DELIVERY: "parcel to deliver", Cell.DELIVERED: "delivered parcel", Cell.PAD: "charging pad"}
"""Prompts call these kinds of cells otherwise than by their names."""
TITLES = {Cell.BUILDING: "Buildings", Cell.TREE: "Trees", Cell.OBSTACLE: "Obstacles", Cell.PAD: "Charging pads"}
FIRST = "BLO BRI CRA DRU FLU FRE GLA GRU KLE KRI PLE PRU SKO SNU STU TRU VLA ZWE"
SECOND = "BA DO FI GU LU MI NA PU SA TI VO ZA"
"""Syllables: a word is one of each, and no two words of a map start alike. None of them means anything."""
KINDS = ("parcel", "road", "building", "tree", "obstacle", "pad")
"""What can be renamed on a map; the drone always keeps its name."""
PLAIN_LETTERS = dict(zip(NAMES, ".BTOPxD?C", strict=True))
DRAWN_LETTERS = "AEFGHJKLMNQRSUVWYZ"
"""No letter of a plain grid."""
WORDS = re.compile(
    r"\b(UP|DOWN|LEFT|RIGHT|WAIT)\b|(?i:\b(an? )?(parcel|road|building|tree|obstacle|(?:charging )?pad)(s?)\b)"
)
PLACES = {"parcels": "delivery", "buildings": "building", "trees": "tree", "obstacles": "obstacle", "pads": "pad"}
"""The kind of cell whose places each value lists."""
OBSERVED: dict[str, Callable[[DroneObservation], object]] = {
    "x": lambda obs: obs.drone_x,
    "y": lambda obs: obs.drone_y,
    "battery_percent": lambda obs: round(100 * obs.battery),
    "battery_steps": lambda obs: obs.battery_steps_remaining,
    "target": lambda obs: (
        "none" if obs.current_target is None else f"({obs.current_target[0]}, {obs.current_target[1]})"
    ),
    "distance": lambda obs: round(obs.distance_to_target or 0),
    "deliveries_done": lambda obs: obs.deliveries_done,
    "deliveries_total": lambda obs: obs.deliveries_total,
    "step": lambda obs: obs.step_count,
    "steps_left": lambda obs: obs.max_steps - obs.step_count,
    "max_steps": lambda obs: obs.max_steps,
    "width": lambda obs: obs.grid_width,
    "height": lambda obs: obs.grid_height,
}
VALUES = {*OBSERVED, *PLACES, "grid", "legend", "history", "task", "drains", "impassable", "terrain", "joined"}
"""All names that a template can use."""


class ImageUrl(TypedDict):
    """Where a picture is."""

    url: str


class ImagePart(TypedDict):
    """A picture in a message."""

    type: Literal["image_url"]
    image_url: ImageUrl


class TextPart(TypedDict):
    """A text beside it."""

    type: Literal["text"]
    text: str


Part = ImagePart | TextPart


class ChatMessage(TypedDict):
    """One message of a request."""

    role: str
    content: str | list[Part]


class Symbols(NamedTuple):
    """The words for actions and cells on a map.

    Attributes:
        names: The drawn name of each renamed action and kind of cell.
        letters: The letter of each kind of cell in the grid as text.
        actions: The words that an answer may contain, in capitals.
    """

    names: Mapping[str, str]
    letters: Mapping[str, str]
    actions: Mapping[str, Action]

    @property
    def legend(self) -> str:
        """The meaning of the letters of the grid."""
        of = self.letters
        return (
            f"{of['drone']} is the drone, {of['delivery']} a parcel to deliver, {of['delivered']} a delivered one, "
            f"{of['road']} road, {of['building']} building, {of['tree']} tree, {of['obstacle']} obstacle, "
            f"{of['pad']} charging pad."
        )

    @property
    def meaning(self) -> str:
        """The meaning of the drawn words that no rule explains; empty if none are drawn."""
        if not self.names:
            return ""
        moves = [f"{self.names[action.name]} {_move(action)}" for action in Action]
        return (
            f"The words for actions and cells are drawn for this map alone: {', '.join(moves)}; "
            f"a cell on which nothing stands is {self.names['road']}."
        )

    def rename(self, text: str) -> str:
        """Replace the plain words of a text by these."""
        return WORDS.sub(self._renamed, text) if self.names else text

    def _renamed(self, found: re.Match[str]) -> str:
        action, article, kind, plural = found.groups()
        if action:
            return self.names[action]
        name = self.names[kind.lower().removeprefix("charging ")]
        # All names start with a consonant.
        before = f"{article[0]} " if article else ""
        return f"{before}{name.capitalize() if kind[0].isupper() else name}{plural}"


PLAIN = Symbols({}, PLAIN_LETTERS, Action.__members__)


@lru_cache(maxsize=256)
def draw_symbols(task: TaskConfig, seed: int) -> Symbols:
    """Draw the names for a map: always the same ones, from other random numbers than those of the map."""
    key = map_key(task_key(f"{task.id}/symbols", task.version), seed)

    def draw(n: int) -> int:
        nonlocal key
        key = next_key(key)
        return uniform_below(key, n)

    first, second, letters = FIRST.split(), SECOND.split(), list(DRAWN_LETTERS)
    words = {name: first.pop(draw(len(first))) + second[draw(len(second))] for name in (*Action.__members__, *KINDS)}
    return Symbols(
        names={name: word if name in Action.__members__ else word.lower() for name, word in words.items()},
        letters={name: "?" if name == "unknown" else letters.pop(draw(len(letters))) for name in NAMES},
        actions={words[name]: action for name, action in Action.__members__.items()},
    )


def _move(action: Action) -> str:
    dx, dy = ACTION_OFFSETS[action]
    axis, way = ("x", dx) if dx else ("y", dy)
    return "waits" if action is Action.WAIT else f"is {axis} {'+' if way > 0 else '-'} 1"


def values_of(
    task: TaskConfig, obs: DroneObservation, last_steps: Sequence[str], symbols: Symbols, names: Collection[str]
) -> dict[str, object]:
    """The values that a template can use.

    Args:
        task: The task.
        obs: What the drone sees.
        last_steps: The last steps, one line each.
        symbols: The letters of the grid.
        names: What the template uses.
    """
    deciding_kinds = set(deciding(task))
    places: dict[str, list[str]] = {kind.name: [] for kind in CELL_KINDS.values()}
    for y, row in enumerate(obs.cell_types):
        for x, name in enumerate(row):
            if name != "road":  # a city has thousands
                places[name].append(f"({x}, {y})")
    listed = {name: " ".join(found) or "none" for name, found in places.items()}
    values = {name: of(obs) for name, of in OBSERVED.items()} | {name: listed[kind] for name, kind in PLACES.items()}
    values |= {
        "grid": "\n".join(" ".join(symbols.letters[name] for name in row) for row in obs.cell_types),
        "legend": symbols.legend,
        "history": "\n".join(["", "Last steps:", *last_steps]) if last_steps else "",
        "task": task,
        "drains": [(_label(kind), units) for kind, units in task.drain if units != 1],
        "impassable": sorted(map(_label, task.impassable)),
        "terrain": [(title, listed[CELL_KINDS[kind].name], kind in deciding_kinds) for kind, title in TITLES.items()],
    }
    if "joined" in names:
        from drone_env.envs.blocks import is_joined  # loads Pillow

        values["joined"] = is_joined(task)
    return values


def _label(kind: Cell) -> str:
    return LABELS.get(kind, CELL_KINDS[kind].name)


def deciding(task: TaskConfig) -> Iterator[Cell]:
    """The kinds of terrain whose places affect the best flight over maps of a task."""
    for kind, count in task.cell_counts().items():
        charges = kind is Cell.PAD and task.charge_rate > 0
        if count and (charges or kind in task.impassable or dict(task.drain).get(kind, 1) != 1):
            yield kind


def picture_part(episode: Episode, size: int) -> ImagePart:
    """The picture of an episode in its current state, by its contents.

    Args:
        episode: The episode; its task is found by its id.
        size: Height in pixels.
    """
    task, actions = episode.task, "".join(map(str, episode.actions))
    shown = {"task": task.id, "version": task.version, "seed": episode.seed, "actions": actions, "size": size}
    return {"type": "image_url", "image_url": {"url": SHOWS + urlencode(shown)}}


def picture_of(url: str) -> bytes:
    """Draw the picture with an address of `picture_part`, as a PNG; equal ones are equal byte for byte."""
    from PIL import Image

    from drone_env.envs.rendering import draw_picture

    shown = dict(parse_qsl(url.removeprefix(SHOWS), keep_blank_values=True))
    episode = Episode(get_task(shown["task"], int(shown["version"])), seed=int(shown["seed"]))
    for action in shown["actions"]:
        episode.step(Action(int(action)))
    file = io.BytesIO()
    Image.fromarray(draw_picture(episode, int(shown["size"]))).save(file, "PNG")
    return file.getvalue()


def with_pictures(messages: Sequence[ChatMessage]) -> tuple[list[ChatMessage], str | None]:
    """Messages as they are sent, with their picture drawn, and its SHA-256; None if there is no picture."""
    sent, digest = list[ChatMessage](), None
    for message in messages:
        content = message["content"]
        if not isinstance(content, str):
            content = list(content)
            for i, part in enumerate(content):
                if part["type"] == "image_url":
                    picture = picture_of(part["image_url"]["url"])
                    digest = hashlib.sha256(picture).hexdigest()
                    url = DRAWN + base64.b64encode(picture).decode()
                    content[i] = {"type": "image_url", "image_url": {"url": url}}
        sent.append({"role": message["role"], "content": content})
    return sent, digest
