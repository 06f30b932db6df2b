"""`deploy/drain.sh` and the list of servers; with a real nginx it runs in `test_nginx.py`."""

import subprocess
from pathlib import Path

import pytest

from tests.tools import ran

FIRST, SECOND = "server 127.0.0.1:8001 max_fails=2;\n", "server 127.0.0.1:8002;\n"


@pytest.fixture
def servers(tmp_path: Path) -> Path:
    file = tmp_path / "servers.conf"
    file.write_text(FIRST + SECOND)
    return file


def drain(servers: Path, *words: str, nginx: str = "true", **variables: str) -> "subprocess.CompletedProcess[str]":
    """Call it with a program in the place of nginx."""
    given = {"SERVERS": str(servers), "NGINX_COMMAND": nginx, "WAIT": "10", **variables}
    return ran("bash", "deploy/drain.sh", *words, **given)


def test_a_server_is_marked_and_the_mark_taken_back(servers: Path) -> None:
    assert drain(servers, "out", "127.0.0.1:8002").returncode == 0
    assert servers.read_text() == FIRST + "server 127.0.0.1:8002 down;\n"
    assert drain(servers, "in", "127.0.0.1:8002").returncode == 0
    assert servers.read_text() == FIRST + SECOND


def test_the_last_server_stays_in_unless_that_is_said(servers: Path) -> None:
    assert drain(servers, "out", "127.0.0.1:8001").returncode == 0
    left = servers.read_text()
    refused = drain(servers, "out", "127.0.0.1:8002")
    assert refused.returncode == 2
    assert "LAST=1" in refused.stderr
    assert servers.read_text() == left
    assert drain(servers, "out", "127.0.0.1:8002", LAST="1").returncode == 0
    assert servers.read_text().count(" down;") == 2


def test_where_nginx_is_not_reloaded_the_list_stays_as_it_was(servers: Path) -> None:
    failed = drain(servers, "out", "127.0.0.1:8001", nginx="false")
    assert failed.returncode == 1
    assert "as it was" in failed.stderr
    assert servers.read_text() == FIRST + SECOND


@pytest.mark.parametrize(
    "words", [("out",), ("off", "127.0.0.1:8001"), ("out", "127.0.0.1:80"), ("out", "127x0.0.1:8001")]
)
def test_what_is_no_order_or_no_server_changes_nothing(servers: Path, words: tuple[str, ...]) -> None:
    assert drain(servers, *words).returncode == 2
    assert servers.read_text() == FIRST + SECOND
