"""The messages of a request: texts, and the map as a picture, which stands there by what it shows until it is sent.

So it stands in transcripts, too: a picture takes 200 KB, and a flight has one for each step. What it looks like depends
on the version of Pillow; what it shows does not, and says which it is to whoever checks a run.
"""

import base64
import hashlib
import io
from collections.abc import Sequence
from typing import Literal
from urllib.parse import parse_qsl, urlencode

from typing_extensions import TypedDict

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task

SMALLEST, LARGEST = 256, 2048
"""Heights in pixels: on smaller ones nothing can be told apart, larger ones are made smaller by all endpoints."""
SHOWS = "drone-env:picture?"
"""What the addresses of pictures that are still to be drawn begin with; what is shown follows."""
DRAWN = "data:image/png;base64,"


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


def picture_part(episode: Episode, size: int) -> ImagePart:
    """The picture of an episode as it stands, by what it shows.

    Args:
        episode: Where it stands; its task is known by its id.
        size: Height in pixels.
    """
    task, actions = episode.task, "".join(map(str, episode.actions))
    shown = {"task": task.id, "version": task.version, "seed": episode.seed, "actions": actions, "size": size}
    return {"type": "image_url", "image_url": {"url": SHOWS + urlencode(shown)}}


def picture_of(url: str) -> bytes:
    """The picture with an address of `picture_part`, as a PNG; equal ones are equal byte for byte."""
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
    """Messages as they are sent, with their picture drawn, and its SHA-256; None where there is none."""
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
