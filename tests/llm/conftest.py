"""Scripted endpoints in a process of their own, and `drone-env infer` against them."""

import json
import os
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drone_env.cli import main
from tests.tools import reserved_port

ROOT = Path(__file__).parents[2]
TOKEN = "sk-test-0123456789"
LINE = re.compile(
    r"\[START\] task=\S+ env=drone_env_v1 model=scripted"
    r"|\[STEP\] step=\d+ action=(?:UP|DOWN|LEFT|RIGHT|WAIT) reward=\d\.\d\d done=(?:true|false) error=\w+"
    r"|\[END\] success=(?:true|false) steps=\d+ score=0\.\d{3} rewards=(?:\d\.\d\d(?:,\d\.\d\d)*)?"
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


def wait_until(holds: Callable[[], bool], process: "subprocess.Popen[Any] | None" = None, seconds: float = 240) -> None:
    """Wait for a condition, while the process runs that is to bring it about."""
    deadline = time.monotonic() + seconds
    while not holds():
        assert process is None or process.poll() is None, f"the process ended with {process.returncode}"
        assert time.monotonic() < deadline, f"waited for {seconds} seconds"
        time.sleep(0.02)


@dataclass
class Infer:
    """What one `drone-env infer` came to."""

    status: int
    out: str
    err: str
    folder: Path

    @property
    def flights(self) -> list[dict[str, Any]]:
        return json_lines(self.folder / "flights.jsonl")

    @property
    def calls(self) -> list[dict[str, Any]]:
        return json_lines(self.folder / "calls.jsonl")

    @property
    def turns(self) -> dict[str, int]:
        """How all turns came out, without the zeros."""
        counts: Counter[str] = Counter()
        for flight in self.flights:
            counts.update(flight["turns"])
        return dict(+counts)


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
        """The requests that came, in their order."""
        return [line for line in json_lines(self.log) if "body" in line]

    def arguments(self, *arguments: str, folder: Path) -> list[str]:
        where = ["--base-url", self.url, "--model", "scripted", "--out", str(folder)]
        return ["infer", *where, "--backoff", "0.05", "--no-report", *arguments]

    def infer(self, *arguments: str, folder: Path | None = None, **more: str) -> Infer:
        """Run it in this process."""
        folder = folder or self.folder / f"{self.log.stem}-run-{self._runs}"
        self._runs += 1
        for name, value in {"OPENAI_API_KEY": TOKEN, **more}.items():
            self._monkeypatch.setenv(name, value)
        self._monkeypatch.chdir(self.folder)
        self._capfd.readouterr()
        status = main(self.arguments(*arguments, folder=folder))
        out, err = self._capfd.readouterr()
        return Infer(status, out, err, folder)


def tell(url: str, script: dict[str, Any]) -> None:
    """Give a scripted endpoint its script."""
    urllib.request.urlopen(f"{url}/script", json.dumps(script).encode(), timeout=60).close()


@pytest.fixture(scope="session")
def scripted_server(tmp_path_factory: pytest.TempPathFactory) -> Generator[str, None, None]:
    """The address of the process that all scripted endpoints are in."""
    log, port = tmp_path_factory.mktemp("scripted") / "errors.log", reserved_port()
    command = [sys.executable, str(Path(__file__).with_name("scripted_server.py")), str(port)]

    def answers() -> bool:
        try:
            tell(f"http://127.0.0.1:{port}/ready", {"log": os.devnull})
        except urllib.error.URLError:
            return False
        return True

    with log.open("wb") as errors:
        process = subprocess.Popen(command, env=environment(), stderr=errors)
        try:
            wait_until(answers, process)
            yield f"http://127.0.0.1:{port}"
        finally:
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
        tell(f"{scripted_server}/{name}", {"log": str(opened[-1].log), **script})
        return opened[-1]

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
    assert main(["replay", str(done.folder / "episodes.jsonl"), "--verify"]) == 0
    assert not any(TOKEN in path.read_text() for path in done.folder.iterdir())
    assert TOKEN not in done.out + done.err
