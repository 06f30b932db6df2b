"""The page as sites see it that show links to it: its head, the picture of a link, and the flight before any script."""

import io
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image
from starlette.testclient import TestClient

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.envs.rendering import draw_card
from drone_env.planning.optimal import solve
from drone_env.results.record import EpisodeRecord, record_of
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


class TestPreview:
    def test_it_is_the_picture_of_the_flight_up_to_the_step(self, shared_client: TestClient) -> None:
        answer = shared_client.get("/preview.png?task=hard&seed=7&pilot=greedy&step=9")
        assert answer.headers["Content-Type"] == "image/png"
        assert Image.open(io.BytesIO(answer.content)).size == (1200, 630)
        episode = flown("hard", "greedy", 9)
        assert answer.content == draw_card(episode, [("Greedy", True), ("step 9", False)])

    def test_an_ended_flight_has_its_score_and_the_optimum_beside_it_and_a_person_is_not_flown_for(
        self, shared_client: TestClient
    ) -> None:
        answer = shared_client.get("/preview.png?task=hard&seed=7&pilots=greedy,human&step=1000")
        episode = flown("hard", "greedy")
        words = [("Greedy", True), (f"score {100 * episode.score:.1f}", False)]
        best = f"optimum {100 * solve('hard', 7).score:.1f}"
        assert answer.content == draw_card(episode, [*words, ("", False), (best, False)])
        map_alone = shared_client.get("/preview.png?task=hard&seed=7").content
        assert map_alone == draw_card(Episode("hard", seed=7), [])

    def test_a_stored_flight_is_shown_as_it_was_flown(self, client: TestClient) -> None:
        record = record_of(flown("easy", "random", seed=5), "somebody")
        stored = client.app.state.shared.store.add_episode(record)  # pyright: ignore
        answer = client.get(f"/preview.png?episode={stored}&step=3&task=hard")
        assert answer.content == draw_card(flown("easy", "random", 3, seed=5), [("somebody", True), ("step 3", False)])
        assert told(client, f"/?episode={stored}")["og:title"] == "somebody: Easy, map 5"

    @pytest.mark.parametrize(
        ("query", "status", "says"),
        [
            ("task=hard", 422, "task=hard&seed=7"),
            ("task=nowhere&seed=7", 404, "unknown task 'nowhere'; allowed: "),
            ("task=hard&seed=7&pilot=nobody", 404, "unknown pilot 'nobody'"),
            ("task=skyline_easy&seed=7&pilot=pathqnet", 422, "'pathqnet' has no skyline_easy_v2.safetensors"),
            ("episode=nothing", 404, "there is no episode 'nothing'"),
        ],
    )
    def test_what_is_wrong_is_told(self, shared_client: TestClient, query: str, status: int, says: str) -> None:
        answer = shared_client.get(f"/preview.png?{query}")
        assert (answer.status_code, answer.headers["Content-Type"]) == (status, "application/json")
        assert says in answer.json()["detail"]


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
        head = told(shared_client, f"/?{query}")
        assert head["og:title"] == title
        where, _, asked = head["og:image"].partition("?")
        assert where == "http://testserver/preview.png"
        assert set(asked.split("&")) == set(query.split("&"))

    @pytest.mark.parametrize("query", ["", "?task=<b>&seed=7", "?episode=nothing"])
    def test_what_leads_to_no_flight_has_the_picture_of_the_flight_on_the_page(
        self, shared_client: TestClient, query: str
    ) -> None:
        head = told(shared_client, f"/{query}")
        assert head["og:title"] == "Drone Delivery"
        assert head["og:image"] == f"http://testserver/preview.png?{FIRST_PAINT.query()}"

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
            head = told(client, f"/?episode={stored}")
            assert (head["og:title"], "og:image" in head) == ("Drone Delivery", False)
            assert client.get(f"/preview.png?episode={stored}").status_code == 401


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
