"""What prompts show of an episode: values as text, and the map as a picture.

A picture is named by its contents until it is sent, also in transcripts: a PNG takes 200 KB, and a flight has one for
each step. The pixels depend on the version of Pillow; the contents do not.
"""

import base64
import hashlib
import io
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Literal
from urllib.parse import parse_qsl, urlencode

from typing_extensions import TypedDict

from drone_env.core.actions import Action
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
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
LETTERS = dict(zip(NAMES, ".BTOPxD?C", strict=True))
"""The letter of each kind of cell in the grid as text."""
LEGEND = (
    "D is the drone, P a parcel to deliver, x a delivered one, . road, B building, T tree, O obstacle, C charging pad."
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


def values_of(
    task: TaskConfig, obs: DroneObservation, last_steps: Sequence[str], names: Collection[str]
) -> dict[str, object]:
    """The values that a template can use.

    Args:
        task: The task.
        obs: What the drone sees.
        last_steps: The last steps, one line each.
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
        "grid": "\n".join(" ".join(LETTERS[name] for name in row) for row in obs.cell_types),
        "legend": LEGEND,
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
