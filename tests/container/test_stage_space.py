"""The staged Space, from a clean export of the repository, by OpenEnv's own checks."""

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from tests.package.installed import copy_tracked

from .test_dockerfile import START, instructions

COLOURS = {"red", "yellow", "green", "blue", "indigo", "purple", "pink", "gray"}


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tracked files, without git."""
    folder = tmp_path_factory.mktemp("export")
    copy_tracked(folder)
    return folder


def stage(export: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "tools/stage_space.py", *arguments]
    return subprocess.run(command, cwd=export, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def space(export: Path) -> Path:
    done = stage(export)
    assert done.returncode == 0, done.stderr
    assert "staged in" in done.stdout
    return export / "build" / "space"


@pytest.fixture(scope="module")
def pushed(space: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `openenv push` makes from it and would upload."""
    from openenv.cli.commands import push

    folder = tmp_path_factory.mktemp("pushed")
    push._prepare_staging_directory(space, "drone-env", folder, push._load_ignore_patterns(space, None))
    return folder


def front_matter(page: Path) -> dict[str, object]:
    """The settings of a Space, at the head of its page."""
    empty, settings, text = page.read_text(encoding="utf-8").split("---\n", 2)
    assert empty == ""
    assert text.lstrip().startswith("# ")
    return yaml.safe_load(settings)


@pytest.mark.long
def test_openenv_takes_it_and_leaves_the_page_and_the_start_as_they_are(space: Path, pushed: Path) -> None:
    from openenv.cli.commands import push
    from openenv.validation import Level, run_validation

    name, manifest = push._validate_openenv_directory(space)
    assert (name, manifest["app"]) == ("drone-env", "drone_env.server.app:app")
    assert run_validation(space, max_level=Level.STATIC).verdict.value == "pass"
    assert front_matter(pushed / "README.md")["base_path"] == "/"
    known = instructions(pushed / "Dockerfile")
    assert [json.loads(rest) for name, rest in known if name == "CMD"] == [START]
    (trusted,) = [rest.split("=")[1] for name, rest in known if name == "ENV" and rest.startswith("FORWARDED")]
    assert address_of(trusted, "198.51.100.1, 203.0.113.9, 10.1.2.3") == "203.0.113.9"
    assert address_of(trusted, "10.9.9.9, 203.0.113.9") == "203.0.113.9"
    assert "/health" in dict(known)["HEALTHCHECK"]


def address_of(trusted: str, forwarded: str) -> str:
    """The address of a visitor whose request the proxy forwards with this `X-Forwarded-For`."""
    seen: list[str] = []

    async def app(scope: Any, *_: object) -> None:
        seen.append(scope["client"][0])

    headers = [(b"x-forwarded-for", forwarded.encode())]
    scope: Any = {"type": "http", "client": ("10.20.0.1", 1), "scheme": "http", "headers": headers}
    asyncio.run(ProxyHeadersMiddleware(app, trusted)(scope, cast(Any, None), cast(Any, None)))
    return seen[0]


def test_the_front_matter_is_what_the_hub_takes(space: Path) -> None:
    settings = front_matter(space / "README.md")
    manifest = yaml.safe_load((space / "openenv.yaml").read_text(encoding="utf-8"))
    assert (settings["sdk"], settings["app_port"], settings["license"]) == ("docker", manifest["port"], "mit")
    assert {settings["colorFrom"], settings["colorTo"]} <= COLOURS
    assert len(str(settings["short_description"])) <= 60


def test_staging_again_replaces_all_but_git_and_no_other_folder(space: Path, export: Path, tmp_path: Path) -> None:
    (space / ".git").mkdir()
    (space / ".git" / "config").write_text("mine")
    (space / "stale").write_text("old")
    assert stage(export).returncode == 0
    assert not (space / "stale").exists()
    assert (space / ".git" / "config").read_text() == "mine"
    (tmp_path / "precious").write_text("mine")
    done = stage(export, str(tmp_path))
    assert (done.returncode, "was not staged by this command" in done.stderr) == (2, True)
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]
