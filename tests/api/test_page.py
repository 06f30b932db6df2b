"""The page before any script: the picture of a link to it, and its greeting."""

import re

import pytest
from starlette.testclient import TestClient

from drone_env.planning.optimal import solve
from drone_env.server import page_files
from drone_env.server.daily import today
from drone_env.server.page_files import PAGE
from tests.api.flying import flown


def test_a_link_to_it_shows_a_picture(shared_client: TestClient) -> None:
    picture = re.search('<meta property="og:image" content="(http.*?)">', shared_client.get("/").text)
    assert picture is not None
    assert shared_client.get(picture[1]).headers["Content-Type"] == "image/png"


class TestHello:
    def test_its_sentence_is_true(self, shared_client: TestClient) -> None:
        html = shared_client.get("/").text
        task, seed = re.findall('data-(?:task|seed)="(.*?)"', html)
        scores = re.findall(r"scored (\S+) of (\S+) possible", html)
        assert scores == [
            (f"{100 * flown(task, 'tournet', seed=int(seed)).score:.1f}", f"{100 * solve(task, int(seed)).score:.1f}")
        ]

    def test_only_the_bare_address_shows_it(self, shared_client: TestClient) -> None:
        html = shared_client.get("/").text
        assert re.findall('<section id="hello"( hidden)?', html) == [""]
        assert f">Map of the day, {today().day} " in html
        html = shared_client.get("/?task=easy&seed=7&pilot=greedy").text
        assert re.findall('<section id="hello"( hidden)?', html) == [" hidden"]


class TestBundle:
    def test_it_is_current(self) -> None:
        assert page_files.is_bundled(), "make bundle writes it again"

    def test_sources_that_have_changed_are_served_instead(
        self, shared_client: TestClient, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        sources = [path.relative_to(PAGE).as_posix() for path in page_files.SOURCES[1:]]
        html = shared_client.get("/?view=learn").text
        assert [name for name in sources if f"/{name}" in html] == ["js/before_modules.js"]
        assert html.count("/bundle/main.js") == html.count("/bundle/page.css") == 1
        monkeypatch.setattr(page_files, "SOURCES", page_files.SOURCES[1:])
        html = shared_client.get("/?view=learn").text
        assert "/bundle/" not in html
        assert {"css/tokens.css", "css/fly.css", "js/main.js"} < {name for name in sources if f"/{name}" in html}
