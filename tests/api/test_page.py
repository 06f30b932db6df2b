"""The page before any script: the picture of a link to it, and its greeting."""

import re

import pytest
from starlette.testclient import TestClient

from drone_env.server import page_files
from drone_env.server.daily import today


def test_a_link_to_it_shows_a_picture(shared_client: TestClient) -> None:
    picture = re.search('<meta property="og:image" content="(http.*?)">', shared_client.get("/").text)
    assert picture is not None
    assert shared_client.get(picture[1]).headers["Content-Type"] == "image/png"


@pytest.mark.parametrize("path", ["/", "/docs", "/health"])
def test_a_head_request_gets_the_headers_of_the_page(shared_client: TestClient, path: str) -> None:
    head, get = shared_client.head(path), shared_client.get(path)
    assert (head.status_code, head.headers["Content-Type"]) == (200, get.headers["Content-Type"])


def test_an_unknown_address_is_an_error(shared_client: TestClient) -> None:
    answer = shared_client.get("/nowhere")
    detail = "there is nothing at /nowhere; /openapi.json lists all calls"
    assert (answer.status_code, answer.json()["detail"]) == (404, detail)
    answer = shared_client.put("/tasks")
    assert (answer.status_code, answer.json()["detail"]) == (405, "Method Not Allowed")


def test_only_the_bare_address_shows_the_greeting(shared_client: TestClient) -> None:
    html = shared_client.get("/").text
    assert re.findall('<section id="hello"( hidden)?', html) == [""]
    assert f">Map of the day, {today().day} " in html
    html = shared_client.get("/?task=easy&seed=7&pilot=greedy").text
    assert re.findall('<section id="hello"( hidden)?', html) == [" hidden"]


def test_the_bundle_is_current() -> None:
    with (page_files.BUNDLE / "main.js").open(encoding="utf-8") as file:
        assert file.readline() == f"// {page_files.sources_digest()}\n", "make bundle writes it again"
