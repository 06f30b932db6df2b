"""Scripted endpoints, and `drone-env infer` against them."""

import itertools
import json
import os
import re
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drone_env.cli import main
from drone_env.llm.run_folder import read_run
from drone_env.llm.text_episode import EpisodeRun

from .scripted_server import Handler, Server, script

ROOT = Path(__file__).parents[2]
TOKEN = "sk-test-0123456789"
ENDPOINTS: dict[str, Any] = json.loads(Path(__file__).with_name("endpoints.json").read_text(encoding="utf-8"))
"""What endpoints respond, and what it comes to."""
LINE = re.compile(
    r"\[START\] task=\S+ env=drone_env_v1 model=scripted"
    r"|\[STEP\] step=\d+ action=(?:UP|DOWN|LEFT|RIGHT|WAIT) reward=\d\.\d\d done=(?:true|false) error=\w+"
    r"|\[END\] success=(?:true|false) steps=\d+ score=(?:0\.\d{3}|null) rewards=(?:\d\.\d\d(?:,\d\.\d\d)*)?"
)


def environment(**more: str) -> dict[str, str]:
    """The environment of a process that runs this checkout with these variables."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def whole_lines(path: Path) -> list[str]:
    """The lines of a file that may be growing: a last one that has no end yet is none."""
    return path.read_text().rpartition("\n")[0].splitlines() if path.exists() else []


def json_lines(path: Path) -> list[dict[str, Any]]:
    """What each whole line of a file holds."""
    return [json.loads(line) for line in whole_lines(path)]


@dataclass
class Infer:
    """What one `drone-env infer` came to."""

    status: int
    out: str
    err: str
    folder: Path

    @property
    def flights(self) -> list[EpisodeRun]:
        return read_run(self.folder).flights

    @property
    def calls(self) -> list[dict[str, Any]]:
        return json_lines(self.folder / "calls.jsonl")

    @property
    def turns(self) -> dict[str, int]:
        """How all turns came out, without the zeros."""
        return dict(Counter(turn for flight in self.flights for turn in flight.turns))


@dataclass
class Endpoint:
    """One scripted endpoint, and runs against it."""

    url: str
    log: list[dict[str, Any]]
    folder: Path
    monkeypatch: pytest.MonkeyPatch
    capfd: pytest.CaptureFixture[str]

    def requests(self) -> list[dict[str, Any]]:
        """The requests that came, in their order."""
        return [line for line in self.log if "body" in line]

    def arguments(self, *arguments: str, folder: Path) -> list[str]:
        where = ["--base-url", self.url, "--model", "scripted", "--out", str(folder)]
        return ["infer", *where, "--backoff", "0.05", "--no-report", *arguments]

    def infer(self, *arguments: str, folder: Path | None = None, **more: str) -> Infer:
        """Run it in this process."""
        folder = folder or Path(tempfile.mkdtemp(prefix="run-", dir=self.folder))
        for name, value in {"OPENAI_API_KEY": TOKEN, **more}.items():
            self.monkeypatch.setenv(name, value)
        self.monkeypatch.chdir(self.folder)
        self.capfd.readouterr()
        status = main(self.arguments(*arguments, folder=folder))
        out, err = self.capfd.readouterr()
        return Infer(status, out, err, folder)


Start = Callable[..., Endpoint]
"""The type of the fixture `endpoint`."""


@pytest.fixture(scope="session")
def scripted_server() -> Generator[str, None, None]:
    """The address of all scripted endpoints, which are in threads of this process."""
    with Server(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def endpoint(
    scripted_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Start:
    """Opens endpoints: `endpoint(pilot="greedy", together=2, faults=[[0, 3, {"status": 500}]])`."""
    numbers = itertools.count()

    def start(**told: Any) -> Endpoint:
        name = f"{tmp_path.name}-{next(numbers)}"
        return Endpoint(f"{scripted_server}/{name}/v1", script(name, told), tmp_path, monkeypatch, capfd)

    return start


def blocks(out: str) -> list[list[str]]:
    """The lines of each flight; fails where anything else is printed or flights are mixed."""
    flights: list[list[str]] = []
    for line in out.splitlines():
        assert LINE.fullmatch(line), line
        if line.startswith("[START]"):
            assert not flights or flights[-1][-1].startswith("[END]")
            flights.append([])
        flights[-1].append(line)
    for lines in flights:
        assert lines[-1].startswith("[END]")
        assert [int(line.split()[1][5:]) for line in lines[1:-1]] == list(range(1, len(lines) - 1))
    return flights


def verified(done: Infer) -> None:
    """Every flight replays, and nothing holds the token."""
    assert main(["replay", str(done.folder / "episodes.jsonl")]) == 0
    assert not any(TOKEN in path.read_text() for path in done.folder.iterdir())
    assert TOKEN not in done.out + done.err
