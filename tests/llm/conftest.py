"""Scripted endpoints in a process of their own, and `drone-env infer` against them."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from drone_env.cli import main
from tests.tools import reserved_port

ROOT = Path(__file__).parents[2]
TOKEN = "sk-test-0123456789"
VARIABLES = ("HF_TOKEN", "OPENAI_API_KEY", "API_BASE_URL", "MODEL_NAME", "DRONE_TASK", "LOCAL_IMAGE_NAME")


def environment(**more: str) -> dict[str, str]:
    """The environment of a process that knows of no endpoint but what is given."""
    kept = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    return {**kept, "PYTHONPATH": str(ROOT), **more}


@dataclass
class Infer:
    """What one `drone-env infer` came to."""

    status: int
    out: str
    err: str
    folder: Path

    @property
    def flights(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "flights.jsonl").read_text().splitlines()]

    @property
    def calls(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "calls.jsonl").read_text().splitlines()]

    @property
    def turns(self) -> dict[str, int]:
        """How all turns came out, without the zeros."""
        counts: dict[str, int] = {}
        for flight in self.flights:
            for name, count in flight["turns"].items():
                if count:
                    counts[name] = counts.get(name, 0) + count
        return counts


class Endpoint:
    """One scripted endpoint, and runs against it."""

    def __init__(
        self, url: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        self.url = f"{url}/v1"
        self.log = folder / f"{url.rpartition('/')[2]}.jsonl"
        self.folder = folder
        self._monkeypatch = monkeypatch
        self._capfd = capfd
        self._runs = 0

    def requests(self) -> list[dict[str, Any]]:
        return [line for line in map(json.loads, self.log.read_text().splitlines()) if "body" in line]

    def arguments(self, *arguments: str, folder: Path) -> list[str]:
        where = ["--base-url", self.url, "--model", "scripted", "--out", str(folder)]
        return ["infer", *where, "--backoff", "0.05", "--no-report", *arguments]

    def infer(self, *arguments: str, folder: Path | None = None, **more: str) -> Infer:
        """Run it in this process."""
        folder = folder or self.folder / f"{self.log.stem}-run-{self._runs}"
        self._runs += 1
        for name in VARIABLES:
            self._monkeypatch.delenv(name, raising=False)
        for name, value in {"OPENAI_API_KEY": TOKEN, **more}.items():
            self._monkeypatch.setenv(name, value)
        self._monkeypatch.chdir(self.folder)
        self._capfd.readouterr()
        status = main(self.arguments(*arguments, folder=folder))
        out, err = self._capfd.readouterr()
        return Infer(status, out, err, folder)


@pytest.fixture(scope="session")
def scripted_server(tmp_path_factory: pytest.TempPathFactory) -> Generator[str, None, None]:
    """The address of the process that all scripted endpoints are in."""
    port = reserved_port()
    log = tmp_path_factory.mktemp("scripted") / "errors.log"
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("scripted_server.py")), str(port)],
            env=environment(),
            stderr=errors,
        )
    deadline = time.monotonic() + 120
    while True:
        assert process.poll() is None, log.read_text()
        try:
            httpx.post(f"http://127.0.0.1:{port}/ready/script", json={"log": os.devnull}).raise_for_status()
            break
        except httpx.ConnectError:
            assert time.monotonic() < deadline, "the scripted server did not start"
            time.sleep(0.1)
    yield f"http://127.0.0.1:{port}"
    process.kill()
    process.wait()
    assert log.read_text() == ""


@pytest.fixture
def endpoint(
    scripted_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., Endpoint]:
    """Opens endpoints: `endpoint(pilot="greedy", latency=0.2, faults=[[0, 3, {"status": 500}]])`."""
    opened: list[Endpoint] = []

    def start(**script: Any) -> Endpoint:
        name = f"{tmp_path.name}-{len(opened)}"
        opened.append(Endpoint(f"{scripted_server}/{name}", tmp_path, monkeypatch, capfd))
        opened[-1].log.touch()
        body = {"log": str(opened[-1].log), **script}
        httpx.post(f"{scripted_server}/{name}/script", json=body, timeout=60).raise_for_status()
        return opened[-1]

    return start
