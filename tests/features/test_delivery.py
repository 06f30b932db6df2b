"""The promises of delivery: manifest, container, scripts, package, documents."""

import json
import re
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from drone_env import TASKS
from tests.api.serving import ROOT, Server
from tests.container.commands import Commands
from tests.container.test_dockerfile import START, instructions, only
from tests.container.test_validate_submission import BANNER, NEEDED
from tests.tools import find_uv

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def run(*command: str, cwd: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.feature("P1")
@pytest.mark.filterwarnings("default::DeprecationWarning")
def test_p1_the_manifest(tmp_path: Path) -> None:
    """openenv.yaml names app, port, tasks and graders, and openenv validate passes"""
    from openenv.cli.__main__ import app
    from typer.testing import CliRunner

    manifest = yaml.safe_load((ROOT / "openenv.yaml").read_text(encoding="utf-8"))
    named = [manifest[key] for key in ("spec_version", "name", "type", "runtime", "app", "port")]
    assert named == [1, "drone-env", "space", "fastapi", "drone_env.server.app:app", 8000]
    levels = [TASKS[f"{level}_delivery"] for level in ("easy", "medium", "hard")]
    assert manifest["tasks"] == [{"id": task.id, "grader": task.grader} for task in levels]
    assert manifest["graders"] == [{"id": task.grader} for task in levels]
    # What the validator reads, where nobody writes beside it. More than the static checks need a container.
    for name in ("openenv.yaml", "Dockerfile"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "validation", tmp_path / "validation")
    done = CliRunner().invoke(app, ["validate", str(tmp_path), "--level", "static"])
    assert done.exit_code == 0, done.output


@pytest.mark.feature("P2")
def test_p2_the_container(tmp_path: Path) -> None:
    """A Dockerfile of two stages with a HEALTHCHECK on port 8000; each build is recorded in data/docker_build.log"""
    told = instructions(ROOT / "Dockerfile")
    names = [name for name, _ in told]
    assert names.count("FROM") == 2
    layers = [("COPY", "pyproject.toml uv.lock ./"), ("COPY", "drone_env drone_env")]
    lock, sources = [told.index(layer) for layer in layers]
    assert any(name == "RUN" and "pip" in rest for name, rest in told[lock:sources]), "dependencies are a layer before"
    assert only("EXPOSE") == "8000"
    assert "/health" in only("HEALTHCHECK")
    assert json.loads(only("CMD")) == START
    commands = Commands(tmp_path / "bin", "git")
    commands.add("docker", "exit ${BUILD_STATUS:-0}")
    log = tmp_path / "data" / "docker_build.log"
    build = (sys.executable, str(ROOT / "tools" / "build_image.py"), "--log", str(log))
    assert commands.run(*build).returncode == 0
    assert commands.run(*build, BUILD_STATUS="3").returncode == 3
    fields = re.findall(r"^(\w+): (.+)$", log.read_text(encoding="utf-8"), re.MULTILINE)
    assert [name for name, _ in fields[:7]] == [
        "BUILD_LOG", "STATUS", "DURATION", "REVISION", "PLATFORM", "BUILDER", "TIMESTAMP",
    ]  # fmt: skip
    assert [value for name, value in fields if name == "STATUS"] == ["COMPLETED", "FAILED"]


@pytest.mark.feature("P3")
def test_p3_validate_submission(server: Server, tmp_path: Path) -> None:
    """validate-submission.sh URL [DIR] checks Space, docker build and openenv validate: All 3/3 checks passed!"""
    commands = Commands(tmp_path / "bin", *NEEDED)
    commands.add("docker", "")
    commands.add("openenv", "")
    script = str(ROOT / "validate-submission.sh")
    done = commands.run(script, server.url, str(ROOT))
    assert (done.returncode, done.stdout[-len(BANNER) :]) == (0, BANNER), done.stdout + done.stderr
    commands.add("openenv", "exit 1")
    done = commands.run(script, server.url, str(ROOT))
    assert (done.returncode, "2/3 checks passed." in done.stdout) == (1, True)
    guide = (ROOT / "docs" / "deployment.md").read_text(encoding="utf-8")
    powershell = re.findall(r"```powershell\n(.*?)```", guide, re.DOTALL)
    assert any("Invoke-RestMethod -Method Post" in block and "openenv validate" in block for block in powershell)


@pytest.mark.feature("P4")
def test_p4_check_graders() -> None:
    """python check_graders.py finds, calls and checks the graders of the manifest"""
    done = run(sys.executable, "check_graders.py")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-2:] == ["Summary: 3 valid graders found.", "LOCAL CHECK PASSED."]


@pytest.mark.feature("P5")
def test_p5_the_package_and_its_lock() -> None:
    """pyproject.toml and uv.lock agree: uv sync and pip install -e ".[dev]" install what is needed"""
    exported = run(find_uv(), "export", "--frozen", "--offline", "--extra", "dev", "--no-emit-project", "--no-hashes")
    assert exported.returncode == 0, exported.stderr
    pins = [Requirement(line) for line in exported.stdout.splitlines() if re.match(r"\w", line)]
    locked = {pin.name: pin for pin in pins if pin.marker is None or pin.marker.evaluate()}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    needed = [Requirement(line) for line in extras["dev"]]
    for requirement in needed:
        if requirement.name == "drone-env":
            needed.extend(Requirement(line) for extra in sorted(requirement.extras) for line in extras[extra])
        elif requirement.marker is None or requirement.marker.evaluate():
            (pin,) = locked[requirement.name].specifier
            assert pin.version in requirement.specifier, requirement
            # These tests run in what `pip install -e ".[dev]"` made.
            assert version(requirement.name) in requirement.specifier, requirement


@pytest.mark.feature("P6")
def test_p6_tests_and_coverage(tmp_path: Path) -> None:
    """pytest runs tests/test_env.py and tests/test_api.py, and tells how much of the code they cover"""
    report = tmp_path / "coverage.json"
    files = ("tests/test_env.py", "tests/test_api.py")
    # Those that take no time: all of them are run beside this one.
    options = (
        "-q",
        "-k",
        "battery or edge or travels",
        "-p",
        "no:cacheprovider",
        "--cov=drone_env",
        f"--cov-report=json:{report}",
    )
    done = run("env", f"COVERAGE_FILE={tmp_path / 'coverage'}", sys.executable, "-m", "pytest", *files, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    covered = json.loads(report.read_text(encoding="utf-8"))["files"]["drone_env/core/state_manager.py"]
    assert covered["summary"]["percent_covered"] > 40


@pytest.mark.feature("P7")
def test_p7_licence_and_guides() -> None:
    """The MIT licence, a guide for contributors, and one for pushing to the Hugging Face Hub"""
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("LICENSE", "CONTRIBUTING.md", "README.md")}
    assert texts["LICENSE"].startswith("MIT License")
    assert "make test" in texts["CONTRIBUTING.md"]
    assert "MIT licence" in texts["README.md"]
    guide = (ROOT / "docs" / "deployment.md").read_text(encoding="utf-8")
    assert "openenv push" in guide
    assert "git push" in guide
