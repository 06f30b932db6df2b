"""The Dockerfile as a text, and the record of a build by a fake builder."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.api.serving import Server
from tests.tools import find_tool, ran, reserved_port

from .commands import ROOT, Commands

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


@pytest.mark.feature("P2")
@pytest.mark.parametrize(("status", "told"), [(0, "COMPLETED"), (3, "FAILED")])
def test_each_build_is_recorded(tmp_path: Path, status: int, told: str) -> None:
    commands, log = Commands(tmp_path / "bin", "git"), tmp_path / "data" / "docker_build.log"
    commands.add(
        "docker", f'case $1 in --version) echo docker 29;; image) echo linux/arm64;; *) echo "$*"; exit {status};; esac'
    )
    tool = str(ROOT / "tools" / "build_image.py")
    done = commands.run(sys.executable, tool, "--log", str(log), "--no-cache")
    assert done.returncode == status, done.stderr
    assert f"build --tag drone-env --no-cache {ROOT}\n" in done.stdout
    fields = dict(line.split(": ") for line in log.read_text().splitlines()[:-1])
    assert (fields["STATUS"], fields["BUILDER"], fields["PLATFORM"]) == (told, "docker 29", "linux/arm64")
    assert re.fullmatch(r"[0-9a-f]{7,}(-dirty)?", fields["REVISION"])
    assert re.fullmatch(r"\d+m \d+s", fields["DURATION"])
