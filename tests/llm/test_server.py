"""Flying in a server beside the rules here."""

import asyncio
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.errors import InvalidValueError
from drone_env.llm.image import ServerFlight
from tests.api.serving import Server
from tests.tools import reserved_port

from .conftest import Endpoint


def test_a_server_flies_along(endpoint: Callable[..., Endpoint], tmp_path: Path) -> None:
    server = Server(["-m", "drone_env.cli", "serve"], tmp_path / "data", reserved_port(), {})
    try:
        done = endpoint(pilot="greedy").infer("--seeds", "14:15", "--server", server.url)
        assert done.status == 0, done.err
        assert done.turns == {"ok": 3}
        (stored,) = httpx.get(f"{server.url}/memory_logs", timeout=30).json()["episodes"]
        assert (stored["seed"], stored["agent"], stored["score"]) == (14, "scripted", 0.99)
        # A server of other rules would show another flight than the one here.
        episode, flight = Episode("easy"), ServerFlight(server.url)
        episode.reset(14)
        asyncio.run(flight.reset(episode, "mine"))
        episode.step(Action.LEFT)
        with pytest.raises(InvalidValueError, match=r"by other rules: map 14, step 1: .* where it is .* here"):
            asyncio.run(flight.step(episode, Action.RIGHT))
        flight.close()
    finally:
        server.kill()


def test_a_server_that_is_none_is_an_error(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="greedy")
    done = scripted.infer("--seeds", "14:15", "--server", f"http://127.0.0.1:{reserved_port()}")
    assert (done.status, done.out) == (2, "")
    assert "did not fly" in done.err
    assert scripted.requests() == []


def test_without_docker_the_image_is_refused(
    endpoint: Callable[..., Endpoint], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert shutil.which("docker", path=os.environ["PATH"]) is None
    done = endpoint(pilot="greedy").infer("--seeds", "14:15", "--use-image")
    assert done.status == 2
    assert "needs Docker" in done.err
