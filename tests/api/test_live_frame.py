"""What one frame of the page's WebSocket costs: one step, one look at the map, one pass of a network."""

import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest
from starlette.testclient import TestClient

import drone_env
from drone_env.agents.pathqnet import Network
from drone_env.core.episode import Episode
from tests.api.live_page import Page

COUNTED = {
    "steps": (Episode, "step"),
    "resets": (Episode, "reset"),
    "looks": (Episode, "grid"),
    "passes": (Network, "__call__"),
}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each of these was called, by anybody."""
    counts: Counter[str] = Counter()

    def count(name: str, owner: type, method: str) -> None:
        called = getattr(owner, method)

        def counting(*arguments: object) -> object:
            counts[name] += 1
            return called(*arguments)

        monkeypatch.setattr(owner, method, counting)

    for name, (owner, method) in COUNTED.items():
        count(name, owner, method)
    return counts


@pytest.mark.parametrize(
    ("pilot", "once"),
    [
        ("pathqnet", {"steps", "looks", "passes"}),
        ("tournet", {"steps", "looks", "passes"}),
        ("human", {"steps", "looks"}),
    ],
)
def test_a_frame_steps_looks_and_asks_once(client: TestClient, calls: Counter[str], pilot: str, once: set[str]) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start(pilot, task="medium")
        for step in range(1, 4):
            calls.clear()
            if pilot == "human":
                page.send("fly", direction="WAIT")
            else:
                page.send("step")
            (moved,) = page.until("frames")["frames"]
            assert moved["frame"]["step"] == step
            assert (moved["frame"]["q_values"] is None) == (pilot == "human")
            assert calls == dict.fromkeys(once, 1)


PACKAGE = Path(drone_env.__file__).parent


@pytest.fixture
def passed() -> Iterator[set[str]]:
    """The files of the package in which any function was called, in the threads that are started from here on."""
    files: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        path = frame.f_code.co_filename
        if event == "call" and path.startswith(f"{PACKAGE}/"):
            files.add(path.removeprefix(f"{PACKAGE}/"))

    before = threading.getprofile()
    threading.setprofile(note)
    yield files
    threading.setprofile(before)


@pytest.mark.parametrize("pilot", ["pathqnet", "greedy", "human"])
def test_a_frame_passes_ten_files_of_the_server_and_the_store(passed: set[str], client: TestClient, pilot: str) -> None:
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start(pilot, task="medium")
        if pilot != "human":
            page.until("values")  # found once for the whole flight
        command = {"kind": "fly", "direction": "UP"} if pilot == "human" else {"kind": "step"}
        page.send(**command)
        page.until("frames")
        passed.clear()
        page.send(**command)
        page.until("frames")
        files = sorted(path for path in passed if path.startswith(("server/", "results/")))
    assert len(files) <= 10, files
    assert "server/live/episodes.py" in files
