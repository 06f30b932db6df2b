"""The page before any script: the picture of a link to it, and its first flight."""

import re

import pytest
from starlette.testclient import TestClient

from drone_env.planning.optimal import solve
from drone_env.results.record import EpisodeRecord
from drone_env.server import page_files
from drone_env.server.page_files import PAGE
from tests.api.live_page import flown
from tools.first_paint import draw


def test_a_link_to_it_shows_a_picture(shared_client: TestClient) -> None:
    picture = re.search('<meta property="og:image" content="(http.*?)">', shared_client.get("/").text)
    assert picture is not None
    assert shared_client.get(picture[1]).headers["Content-Type"] == "image/png"


class TestHello:
    def test_the_flight_is_as_good_as_can_be_where_greedy_loses_most_of_it(self) -> None:
        record = EpisodeRecord.read((PAGE / "first_paint.json").read_bytes(), "")
        task, seed, best = record.task, record.seed, solve(record.task, record.seed).score
        assert record.score == best == flown(task, record.agent, seed=seed).score
        assert flown(task, "greedy", seed=seed).score < best / 2

    def test_it_stands_on_the_page_of_the_bare_address_alone(self, shared_client: TestClient) -> None:
        html = shared_client.get("/").text
        assert html.count('<section id="hello"') == html.count("/css/hello.css") == 1
        html = shared_client.get("/?task=easy&seed=7&pilot=greedy").text
        assert not any(part in html for part in ('id="hello"', "hello.css"))

    def test_its_files_are_drawn_from_the_record(self) -> None:
        for path, text in draw().items():
            assert path.read_text(encoding="utf-8") == text, "python -m tools.first_paint draws them again"


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
