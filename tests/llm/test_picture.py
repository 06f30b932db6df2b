"""Prompts that show the map as a picture: what is sent, what is kept of it."""

import base64
import hashlib
import io
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.envs.rendering import draw_picture
from drone_env.llm.content import DRAWN, picture_of, picture_part
from drone_env.llm.prompt import first_messages, get_prompt

from .conftest import Endpoint
from .log_lines import verified

Start = Callable[..., Endpoint]
THREE = ("--task", "hard", "--seeds", "14:15", "--prompt", "vision", "--max-calls", "3")


def sent(request: dict[str, Any]) -> bytes:
    """The picture of a request."""
    picture, text = request["body"]["messages"][1]["content"]
    assert (picture["type"], text["type"]) == ("image_url", "text")
    return base64.b64decode(picture["image_url"]["url"].removeprefix(DRAWN), validate=True)


def test_each_call_shows_the_map_as_it_stands(endpoint: Start) -> None:
    scripted = endpoint(pilot="RIGHT")
    done = scripted.infer(*THREE)
    assert done.turns == {"ok": 3, "budget_stop": 1}, done.err
    episode = Episode("hard", seed=14)
    for request, call in zip(scripted.requests(), done.calls, strict=True):
        picture = sent(request)
        assert picture.startswith(b"\x89PNG")
        assert np.array_equal(np.array(Image.open(io.BytesIO(picture))), draw_picture(episode, 768))
        x, y = episode.position
        # The transcript has what it shows, and a digest of what it looked like.
        part, text = call["messages"][1]["content"]
        assert part == picture_part(episode, 768)
        assert picture_of(part["image_url"]["url"]) == picture
        assert call["picture"] == hashlib.sha256(picture).hexdigest()
        assert text["text"].startswith(f"Position: ({x}, {y})\n")
        assert "Parcels" not in text["text"]
        episode.step(Action.RIGHT)
    assert (done.folder / "calls.jsonl").stat().st_size < 20_000
    verified(done)


def test_another_map_is_another_request_however_alike_the_text(endpoint: Start) -> None:
    parts = [picture_part(Episode("easy", seed=seed), 768)["image_url"]["url"] for seed in (14, 15)]
    assert parts[0] != parts[1]
    scripted = endpoint(pilot="RIGHT")
    for cached in (False, True):
        done = scripted.infer("--seeds", "14:15", "--prompt", "vision", "--max-calls", "1", "--cache", "cache")
        # Nothing was sent for an answer from the cache.
        assert (done.calls[0]["cached"], done.calls[0]["picture"] is None) == (cached, cached)
    assert len({sent(request) for request in scripted.requests()}) == 2


def test_the_legend_names_what_there_is() -> None:
    easy, skyline = (
        first_messages(get_prompt("vision"), Episode(task, seed=14))[0]["content"] for task in ("easy", "skyline_easy")
    )
    for look in ("a blue square with a flash is a charging pad", "A red frame with a sign of no entry"):
        assert (look in easy, look in skyline) == (False, True)
    assert "\n\n" not in skyline
