"""Prompts that show the map as a picture: what is sent, what is kept of it."""

import base64
import hashlib
import io
from collections.abc import Callable

import numpy as np
from PIL import Image

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.envs.rendering import draw_picture
from drone_env.llm.content import DRAWN, picture_of, picture_part

from .conftest import Endpoint


def test_each_call_shows_the_map_as_it_stands(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="RIGHT")
    done = scripted.infer("--task", "hard", "--seeds", "14:15", "--prompt", "vision", "--max-calls", "2")
    assert done.turns == {"ok": 2, "budget_stop": 1}, done.err
    episode = Episode("hard", seed=14)
    for request, call in zip(scripted.requests(), done.calls, strict=True):
        sent, _ = request["body"]["messages"][1]["content"]
        picture = base64.b64decode(sent["image_url"]["url"].removeprefix(DRAWN), validate=True)
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


def test_another_map_is_another_request_however_alike_the_text() -> None:
    first, second = (picture_part(Episode("easy", seed=seed), 768)["image_url"]["url"] for seed in (14, 15))
    assert first != second
