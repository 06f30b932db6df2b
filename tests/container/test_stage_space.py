"""The staged Space, from a clean export of the repository, by OpenEnv's own checks."""

import asyncio
import json
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from tests.package.installed import copy_tracked
from tools.stage_space import stage

from .test_dockerfile import START, instructions


@pytest.fixture
def export(tmp_path: Path) -> Path:
    """The tracked files, without git."""
    copy_tracked(tmp_path / "export")
    return tmp_path / "export"


@pytest.mark.long
def test_openenv_takes_it_and_leaves_the_page_and_the_start_as_they_are(export: Path, tmp_path: Path) -> None:
    from openenv.cli.commands import push
    from openenv.validation import Level, run_validation

    space, pushed = tmp_path / "space", tmp_path / "pushed"
    pushed.mkdir()
    stage(space, export)
    name, manifest = push._validate_openenv_directory(space)
    assert (name, manifest["app"]) == ("drone-env", "drone_env.server.app:app")
    assert run_validation(space, max_level=Level.STATIC).verdict.value == "pass"
    # What `openenv push` would upload.
    push._prepare_staging_directory(space, "drone-env", pushed, push._load_ignore_patterns(space, None))
    empty, settings, _ = (pushed / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    front_matter = yaml.safe_load(settings)
    assert empty == ""
    assert front_matter.items() >= {"sdk": "docker", "app_port": 8000, "license": "mit", "base_path": "/"}.items()
    assert len(front_matter["short_description"]) <= 60
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


def test_staging_again_replaces_all_but_git_and_no_other_folder(export: Path, tmp_path: Path) -> None:
    space = tmp_path / "space"
    stage(space, export)
    for name in (".git", "stale"):
        (space / name).touch()
    stage(space, export)
    assert ((space / ".git").exists(), (space / "stale").exists()) == (True, False)
    with pytest.raises(FileExistsError, match="was not staged by this command"):
        stage(export, export)
