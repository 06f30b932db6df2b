"""The page as sites see it that show links to it: its head, the picture of a link, and the flight before any script."""

from html.parser import HTMLParser
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from drone_env.core.tasks import get_task
from drone_env.planning.optimal import solve
from drone_env.results.record import EpisodeRecord, record_of
from drone_env.server import page_files
from drone_env.server.app import create_app
from drone_env.server.page_files import PAGE
from drone_env.server.routes.page import FIRST_PAINT
from drone_env.server.settings import Settings
from tests.api.live_page import flown
from tools.first_paint import draw


class Meta(HTMLParser):
    """The `meta` elements of a page, by name."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: dict[str, str] = {}
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        name = given.get("property") or given.get("name")
        if tag == "meta" and name:
            self.found[name] = str(given["content"])


def told(client: TestClient, address: str, **headers: str) -> dict[str, str]:
    return Meta(client.get(address, headers=headers).text).found


class TestHead:
    @pytest.mark.parametrize(
        ("query", "title"),
        [
            ("task=hard&seed=7&pilot=pathqnet&step=38", "PathQNet: Hard, map 7, step 38"),
            ("task=skyline_medium&seed=43&pilots=tournet,greedy", "Tournet: Skyline Medium, map 43"),
            ("task=easy&seed=7&pilot=human", "Fly it yourself: Easy, map 7"),
        ],
    )
    def test_it_tells_of_the_flight_that_the_address_asks_for(
        self, shared_client: TestClient, query: str, title: str
    ) -> None:
        assert told(shared_client, f"/?{query}")["og:title"] == title

    @pytest.mark.parametrize("query", ["", "?task=<b>&seed=7", "?episode=nothing"])
    def test_what_leads_to_no_flight_has_the_picture_alone(self, shared_client: TestClient, query: str) -> None:
        head = told(shared_client, f"/{query}")
        assert head["og:title"] == "Drone Delivery"
        assert shared_client.get(head["og:image"]).headers["Content-Type"] == "image/png"

    def test_what_callers_write_is_text_there(self, client: TestClient) -> None:
        name = '"><script>alert(1)</script>'
        record = record_of(flown("easy", "random", seed=5), name)
        stored = client.app.state.shared.store.add_episode(record)  # pyright: ignore
        assert "<script>alert" not in client.get(f"/?episode={stored}").text
        assert told(client, f"/?episode={stored}")["og:title"] == f"{name}: Easy, map 5"

    def test_without_the_token_nothing_is_told_or_shown_of_any_flight(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings.model_validate({"data": tmp_path, "token": "s3cret"}))) as client:
            record = record_of(flown("easy", "random", seed=5), "somebody")
            stored = client.app.state.shared.store.add_episode(record)  # pyright: ignore
            assert told(client, f"/?episode={stored}")["og:title"] == "Drone Delivery"


class TestHello:
    def test_the_flight_is_as_good_as_can_be_where_greedy_loses_most_of_it(self) -> None:
        record = EpisodeRecord.read((PAGE / "first_paint.json").read_bytes(), "")
        task, seed, best = record.task, record.seed, solve(record.task, record.seed).score
        assert (task, seed, record.agent) == (get_task(FIRST_PAINT.task).id, FIRST_PAINT.seed, FIRST_PAINT.pilot)
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
