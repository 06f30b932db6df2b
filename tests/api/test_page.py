"""The page before any script: the picture of a link to it, and its greeting."""

import re
from statistics import fmean

import pytest
from starlette.testclient import TestClient

from drone_env.server import page_files
from drone_env.server.daily import today
from tests.api.flying import flown


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


class TestHello:
    def test_its_sentence_and_its_failure_are_those_of_the_shipped_results(self, shared_client: TestClient) -> None:
        html = shared_client.get("/").text
        (run,) = {
            row["run"] for row in shared_client.get("/leaderboard/skyline_medium/runs").json()["boards"][-1]["rows"]
        }
        query = {"agent": "tournet", "run": run}
        maps = shared_client.get("/leaderboard/skyline_medium/maps", params=query).json()["maps"]
        score, optimum, success = (
            100 * fmean(of_map[name] for of_map in maps) for name in ("score", "optimum", "success")
        )
        figures = f"scores {score:.1f} of {optimum:.1f} possible and delivers everything on {success:.1f} %."
        assert f"Over {len(maps):,} unseen maps, a trained network {figures}" in html
        (seed,) = re.findall(r'seed=(\d+)&amp;pilot=tournet&amp;step=\d+">See it fail', html)
        worst = max(maps, key=lambda of_map: of_map["optimum"] - of_map["score"])
        assert (int(seed), worst["success"]) == (worst["seed"], 0)
        assert flown("skyline_medium", "tournet", seed=worst["seed"]).score == worst["score"]

    def test_only_the_bare_address_shows_it(self, shared_client: TestClient) -> None:
        html = shared_client.get("/").text
        assert re.findall('<section id="hello"( hidden)?', html) == [""]
        assert f">Map of the day, {today().day} " in html
        html = shared_client.get("/?task=easy&seed=7&pilot=greedy").text
        assert re.findall('<section id="hello"( hidden)?', html) == [" hidden"]


def test_the_bundle_is_current() -> None:
    with (page_files.BUNDLE / "main.js").open(encoding="utf-8") as file:
        assert file.readline() == f"// {page_files.sources_digest()}\n", "make bundle writes it again"


def test_what_it_preloads_is_served_and_used(shared_client: TestClient) -> None:
    """The browser also warns when a busy machine uses a file late, so its warnings cannot be the test."""
    files = re.findall(r'rel="preload" href="([^"]+)"[^>]* crossorigin>', shared_client.get("/").text)
    used = "".join((page_files.BUNDLE / name).read_text("utf-8") for name in ("page.css", "main.js"))
    assert len(files) == 3
    for file in files:
        assert shared_client.get(f"/{file}").status_code == 200
        assert f"../{file.removeprefix('static/')}" in used
