"""The application in this process, and clients of it."""

import time
from collections.abc import Generator
from http.cookiejar import DefaultCookiePolicy
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.server.app import create_app
from drone_env.server.settings import Settings

NO_COOKIES = DefaultCookiePolicy(allowed_domains=())
"""Rejects all cookies, so that only the header identifies a session."""


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, Any]:
    """Settings of the application; override them with `@pytest.mark.parametrize("settings", ...)`."""
    return {"data": tmp_path / "data"}


@pytest.fixture
def client(settings: dict[str, Any]) -> Generator[TestClient, None, None]:
    """A client without cookies."""
    with TestClient(create_app(Settings(**settings))) as running:
        running.cookies.jar.set_policy(NO_COOKIES)
        yield running


class Clock:
    """A clock that tests set."""

    def __init__(self) -> None:
        self.now = time.time()

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(scope="module")
def shared_client(tmp_path_factory: pytest.TempPathFactory) -> Generator[TestClient, None, None]:
    """A client with default settings that the tests of a module share."""
    with TestClient(create_app(Settings(data=tmp_path_factory.mktemp("shared") / "data"))) as running:
        running.cookies.jar.set_policy(NO_COOKIES)
        yield running


@pytest.fixture
def session(client: TestClient) -> dict[str, str]:
    """The header of a session on easy map 7."""
    return {"X-Session-Id": client.post("/reset", json={"seed": 7}).json()["session_id"]}
