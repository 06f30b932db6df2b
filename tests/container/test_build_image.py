"""Builds are recorded, whatever becomes of them. Docker is a script here: what is tested is the record."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from .commands import ROOT, Commands

TOOL = str(ROOT / "tools" / "build_image.py")
DOCKER = """
case "$1 $2" in
  "context show") echo desktop-linux ;;
  "image inspect") echo linux/arm64 ;;
  build*) echo "build: $*"; [ -z "$BUILD_SECONDS" ] || exec sleep "$BUILD_SECONDS"; exit "${BUILD_STATUS:-0}" ;;
esac
"""
RECORD = re.compile(
    r"BUILD_LOG: drone_env\nSTATUS: (COMPLETED|FAILED)\nDURATION: \d+m \d+s\nREVISION: (\S+)\nPLATFORM: (\S+)\n"
    r"BUILDER: (.+)\nTIMESTAMP: \d{4}-\d\d-\d\d \d\d:\d\d:\d\d\n-{40}\n"
)


@pytest.fixture
def docker(tmp_path: Path) -> Commands:
    commands = Commands(tmp_path / "bin", "git")
    commands.add("docker", DOCKER)
    return commands


def records(log: Path) -> list[tuple[str, ...]]:
    """(status, revision, platform, builder) of each record; there is nothing else in the log."""
    text = log.read_text(encoding="utf-8")
    assert RECORD.sub("", text) == ""
    return [match.groups() for match in RECORD.finditer(text)]


@pytest.mark.feature("P2")
def test_builds_are_recorded_whether_they_succeed_or_fail(docker: Commands, tmp_path: Path) -> None:
    log = tmp_path / "data" / "docker_build.log"
    done = docker.run(sys.executable, TOOL, "--log", str(log), "--build-arg", "BASE=mine")
    assert done.returncode == 0, done.stderr
    assert f"build: build --tag drone-env --build-arg BASE=mine {ROOT}" in done.stdout
    failed = docker.run(sys.executable, TOOL, "--log", str(log), "--context", str(tmp_path), BUILD_STATUS="3")
    assert failed.returncode == 3
    (first, revision, *machine), (second, unknown, *_) = records(log)
    assert (first, second, unknown, machine) == ("COMPLETED", "FAILED", "unknown", ["linux/arm64", "desktop-linux"])
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert head.startswith(revision.removesuffix("-dirty"))


def test_a_build_that_is_stopped_is_recorded_as_failed(docker: Commands, tmp_path: Path) -> None:
    log = tmp_path / "log"
    environment = {"PATH": str(docker.folder), "BUILD_SECONDS": "1000"}
    process = subprocess.Popen([sys.executable, "-u", TOOL, "--log", str(log)], env=environment, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"build:")
        process.send_signal(signal.SIGTERM)
        # Long before the build would end; its end closes the output.
        assert process.communicate(timeout=120)[0].startswith(b"FAILED after")
        assert process.returncode == 130
    finally:
        process.kill()
        process.wait()
    assert [status for status, *_ in records(log)] == ["FAILED"]
