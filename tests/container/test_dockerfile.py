"""The Dockerfile as a text; `tools/check_image.py` builds it and proves the image."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.api.serving import Server
from tests.tools import find_tool, ran, reserved_port

from .commands import ROOT

START = ["python", "drone_env/server/app.py", "--host", "0.0.0.0", "--port", "8000"]


def instructions(dockerfile: Path) -> list[tuple[str, str]]:
    """(instruction, the rest) in order, without comments, with continued lines joined."""
    text = re.sub(r"^\s*#.*\n", "", dockerfile.read_text(encoding="utf-8"), flags=re.MULTILINE)
    lines = text.replace("\\\n", " ").splitlines()
    return [(line.split(None, 1)[0], line.split(None, 1)[1].strip()) for line in lines if line.strip()]


def only(name: str) -> str:
    """The one instruction of this name."""
    (found,) = [rest for instruction, rest in instructions(ROOT / "Dockerfile") if instruction == name]
    return found


def test_hadolint_finds_nothing() -> None:
    done = ran(find_tool("hadolint"), "Dockerfile")
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.feature("P2")
def test_it_has_two_stages_and_starts_as_documented() -> None:
    known = instructions(ROOT / "Dockerfile")
    assert known[0] == ("ARG", "BASE=python:3.12-slim-bookworm")
    assert [rest for name, rest in known if name == "FROM"] == ["${BASE} AS dependencies", "${BASE}"]
    assert (json.loads(only("CMD")), only("EXPOSE"), only("USER")) == (START, "8000", "1000:1000")
    assert "VOLUME" not in dict(known)  # OpenEnv's validator refuses an image with one


@pytest.mark.feature("P2")
def test_the_sources_do_not_invalidate_the_dependencies() -> None:
    known = instructions(ROOT / "Dockerfile")
    lock, sources = known.index(("COPY", "pyproject.toml uv.lock ./")), known.index(("COPY", "drone_env drone_env"))
    assert [name for name, _ in known[:lock]].count("COPY") == 0
    assert any(name == "RUN" and "pip" in rest for name, rest in known[lock:sources])


@pytest.mark.feature("P2")
def test_a_language_model_can_fly_in_it() -> None:
    (locked,) = [rest for name, rest in instructions(ROOT / "Dockerfile") if name == "RUN" and "uv export" in rest]
    assert re.findall(r"--extra (\S+)", locked) == ["server", "llm"]
    # Under a read-only root, a run writes where the server writes.
    (environment,) = [rest for name, rest in instructions(ROOT / "Dockerfile") if name == "ENV" and "DATA" in rest]
    folders = dict(part.split("=") for part in environment.split())
    assert folders["DRONE_ENV_DATA"].startswith("/tmp/")
    assert folders["MPLCONFIGDIR"].startswith("/tmp/")
    assert folders["DRONE_ENV_CACHE"].startswith("/tmp/"), "else a user without a home compiles in every process"


def test_what_it_copies_is_there_and_not_ignored() -> None:
    copied = [rest.split()[:-1] for name, rest in instructions(ROOT / "Dockerfile") if name == "COPY"]
    named = {source for sources in copied if not sources[0].startswith("--from") for source in sources}
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert named == kept
    assert [source for source in named if not (ROOT / source).exists()] == []


def health_command(port: int) -> list[str]:
    """The HEALTHCHECK as it stands, of a server on another port."""
    command = json.loads(only("HEALTHCHECK").partition(" CMD ")[2])
    assert command[0] == "python"
    assert "127.0.0.1:8000/health" in command[2]
    return [sys.executable, "-S", "-c", command[2].replace(":8000", f":{port}")]


def test_the_healthcheck_passes_while_a_server_runs(server: Server) -> None:
    port = int(server.url.rpartition(":")[2])
    assert subprocess.run(health_command(port), check=False).returncode == 0
    assert subprocess.run(health_command(reserved_port()), capture_output=True, check=False).returncode != 0
