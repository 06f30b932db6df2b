"""What the project's first description has people type, as it stands there, in a fresh clone.

Each way to start the server and the Python client are in tests/api/test_starting.py, what is typed to build and to
hand in in tests/container.
"""

import contextlib
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest

from tests.llm.conftest import endpoint, scripted_server, wait_until
from tests.package.installed import copy_tracked
from tests.tools import find_uv, missing_tool, reserved_port

__all__ = ["endpoint", "scripted_server"]
SERVE = "python drone_env/server/app.py --port 8000"
TRAIN = "python train.py --task easy_delivery --episodes 500"
JSON = "-H 'Content-Type: application/json'"
CALLS = (
    f"curl -X POST http://localhost:8000/reset {JSON} -d '{{}}'",
    "curl -X POST http://localhost:8000/reset",
    f"""curl -X POST http://localhost:8000/step {JSON} -d '{{"direction": "UP"}}'""",
    "curl http://localhost:8000/state",
    "curl http://localhost:8000/grade/easy_delivery",
    "curl http://localhost:8000/path_history",
    "curl -X POST http://localhost:8000/predict",
    "curl http://localhost:8000/analyse/easy_delivery",
    "curl http://localhost:8000/memory_logs",
    "curl http://localhost:8000/logs",
    "curl http://localhost:8000/terminal_logs",
    "curl http://localhost:8000/tasks",
    "curl http://localhost:8000/graders",
    "curl http://localhost:8000/health",
    "curl http://localhost:8000/docs",
    "curl http://localhost:8000",
)
"""Every call of its table, without a cookie or the id of a session."""


class Clone:
    """A fresh clone, and a shell in it.

    Args:
        folder: Where it is made.
        programs: The folder of the environment's programs, first in the path; None for nothing but the system's.
    """

    def __init__(self, folder: Path, programs: Path | None) -> None:
        self.folder = folder
        copy_tracked(folder)
        self.port = reserved_port()
        ours = ("VIRTUAL_ENV", "PYTHONPATH", "UV_PROJECT_ENVIRONMENT", "DRONE_ENV_REQUIRE_TOOLS", "PYTEST_ADDOPTS")
        self.environment = {name: value for name, value in os.environ.items() if name not in ours}
        if programs:
            self.environment["PATH"] = f"{programs}{os.pathsep}{os.environ['PATH']}"
            self.environment["PYTHONPATH"] = str(folder)

    def start(self, line: str, log: Path, **variables: str) -> "subprocess.Popen[bytes]":
        """Type a line, and do not wait for its end; what it says goes to a file. The port is one of its own."""
        with log.open("ab") as output:
            return subprocess.Popen(
                ["bash", "-c", line.replace("8000", str(self.port))],
                cwd=self.folder,
                env={**self.environment, **variables},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )

    def type(self, line: str, **variables: str) -> tuple[int, str]:
        """Type a line; its exit status, and all that it said."""
        log = self.folder / "typed.log"
        log.unlink(missing_ok=True)
        with ended(self.start(line, log, **variables)) as process:
            return process.wait(timeout=1200), log.read_text(encoding="utf-8")

    @contextlib.contextmanager
    def serving(self, line: str = SERVE) -> Generator[Path, None, None]:
        """A server, for the time of the block; its log."""
        log = self.folder / "serve.log"
        with ended(self.start(line, log)) as process:
            wait_until(self._listens, process)
            yield log

    def _listens(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=5):
            return True
        return False

    def ask(self, call: str) -> dict[str, Any]:
        """What the server answers to a call by curl that is to succeed."""
        status, said = self.type(f"{call} --no-progress-meter --fail-with-body")
        assert status == 0, f"{call}: {said}"
        return json.loads(said) if said.startswith("{") else {}


@contextlib.contextmanager
def ended(process: "subprocess.Popen[bytes]") -> Generator["subprocess.Popen[bytes]", None, None]:
    """A process and its children, ended with the block."""
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=30)
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    """A clone, and the environment of these tests."""
    return Clone(tmp_path / "clone", Path(sys.executable).parent)


def test_a_server_curl_and_a_language_model(clone: Clone, endpoint: Callable) -> None:
    if shutil.which("curl") is None:
        missing_tool("curl")
    with clone.serving():
        answers = {call.rpartition("8000/")[2].split()[0]: clone.ask(call) for call in CALLS}
        flown = [answers[call]["step_count"] for call in ("step", "state", "path_history")]
        assert flown == [1, 1, 1]

        key, pilot = "OPENAI_API_KEY=sk-your-key", endpoint(pilot="able")
        status, said = clone.type(f"{key} API_BASE_URL={pilot.url} python inference.py")
        assert status == 0, said
        assert "[START] task=drone_env.graders:grade_easy env=drone_env_v1 model=Qwen/Qwen2.5-7B-Instruct" in said
        assert "[END] success=true" in said
        assert len(clone.ask("curl http://localhost:8000/memory_logs")["episodes"]) == 1
        assert clone.ask("curl http://localhost:8000/analyse/easy_delivery")["episodes"] == 1


def test_the_key_of_openai_alone_asks_openai(clone: Clone) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        way = {"HTTPS_PROXY": f"http://127.0.0.1:{proxy.getsockname()[1]}", "NO_PROXY": "", "no_proxy": ""}
        with ended(
            clone.start("OPENAI_API_KEY=sk-your-key python inference.py", clone.folder / "asked.log", **way)
        ) as process:
            wait_until(lambda: bool(select.select([proxy], [], [], 0)[0]), process)
            asked, _ = proxy.accept()
            with asked:
                assert asked.recv(1000).startswith(b"CONNECT api.openai.com:443 ")


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.feature("L4")
def test_the_first_training_reads_as_one_that_learns(clone: Clone) -> None:
    pytest.importorskip("torch")
    log = clone.folder / "train.out"
    with ended(clone.start(TRAIN, log)) as process:
        wait_until((clone.folder / "data" / "easy.pth").exists, process)
        assert process.poll() is None, "the first checkpoint came at the end"
        assert process.wait(timeout=600) == 0, log.read_text()
    logged = (clone.folder / "data" / "train.log").read_text()
    assert "nan" not in logged + log.read_text()
    lines = [dict(part.split("=") for part in line.split()) for line in logged.splitlines()]
    assert [int(line["episode"]) for line in lines] == list(range(20, 501, 20))
    for figure in ("score", "success", "reward"):
        first, last = (sum(float(line[figure]) for line in part) / 8 for part in (lines[:8], lines[-8:]))
        assert last > first + 0.15
    assert all(float(line["success"]) > 0.9 for line in lines[-8:])
    validated = [float(line["validation"]) for line in lines if line["validation"] != "-"]
    assert validated[0] < 0.8
    assert validated[-1] > 0.9
    status, said = clone.type(TRAIN)
    assert (status, "Traceback" in said) == (0, False), said
    assert "500" in said
    with clone.serving() as served:
        assert clone.ask("curl http://localhost:8000/logs")["lines"] == logged.splitlines()[-50:]
        # It listens first, and tells this before it answers.
        assert "easy.safetensors" in served.read_text()
        answers = [clone.ask(call) for call in CALLS if "/reset" in call or "/predict" in call]
        assert answers[-1]["model"]


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_uv_sync_brings_all_but_pytorch(tmp_path: Path, endpoint: Callable) -> None:
    clone = Clone(tmp_path / "clone", None)
    clone.environment["PATH"] = f"{Path(find_uv()).parent}{os.pathsep}{os.environ['PATH']}"
    # Not another Python than these tests run on.
    clone.environment["UV_PYTHON"] = sys.executable
    status, said = clone.type("uv sync")
    if "Failed to fetch" in said:
        missing_tool("an index of packages")
    assert status == 0, said
    clone.environment["PATH"] = f"{clone.folder / '.venv' / 'bin'}{os.pathsep}{clone.environment['PATH']}"

    status, said = clone.type(TRAIN)
    assert status == 2, said
    assert "type: uv sync --extra train --inexact" in said
    key, pilot = "HF_TOKEN=hf_your_token_here", endpoint(pilot="able")
    status, said = clone.type(f"{key} API_BASE_URL={pilot.url} python inference.py")
    assert (status, "[END] success=true" in said) == (0, True), said
    status, said = clone.type("python check_graders.py")
    assert (status, "3 valid graders found." in said) == (0, True), said
    with clone.serving("uv run server --port 8000"):
        assert clone.ask("curl http://localhost:8000/health")["status"] == "healthy"

    status, said = clone.type("uv run pytest tests/test_env.py -v")
    assert (status, "missing: torch; to run them: uv sync --extra dev --inexact" in said) == (0, True), said
    status, said = clone.type("uv run pytest tests/test_api.py -v")
    assert status == 0, said
    status, said = clone.type("uv run pytest tests/ -v --collect-only --quiet")
    assert (status, "error" in said.splitlines()[-1]) == (0, False), said
