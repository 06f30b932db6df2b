"""The API view: the snippets do what they say, and the logs show requests, training and flights as they come."""

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from drone_env.client import DroneEnvClient
from tests.api.serving import Server
from tests.browser.conftest import MARKUP, TRAINING
from tests.browser.shown import expect_step
from tests.browser.stage import copied, view
from tests.docs.pages import ROOT, blocks


def test_the_snippets_stand_in_the_docs_and_that_of_curl_flies(page: Page, server: Server, tmp_path: Path) -> None:
    view(page, "API")
    expect(page.locator("#view-api .about")).to_contain_text(f"This server is {server.url}.")
    shown = page.locator(".snippet pre").all_inner_texts()
    # The tests of the documentation run these.
    documented = [
        block.text.strip().replace("localhost", "127.0.0.1")
        for name in ("http", "openenv", "gymnasium")
        for block in blocks(ROOT / "docs" / f"{name}.md")
        if not block.not_run
    ]
    assert [text for text in shown if text.replace(server.url, "http://127.0.0.1:8000") not in documented] == []
    assert len(shown) == 3
    script = copied(page, "Copy: HTTP, by curl", "Copied.")
    assert script == shown[0]
    lines = [line + " && echo" for line in script.splitlines()]
    done = subprocess.run(["bash", "-ec", "\n".join(lines)], cwd=tmp_path, capture_output=True, text=True, check=True)
    reset, step, grade = (json.loads(line) for line in done.stdout.splitlines() if line)
    assert (reset["step_count"], step["step_count"], grade["score"]) == (0, 1, step["score"])


def test_all_calls_can_be_tried_without_the_internet(page: Page, beside: Callable[..., Page], server: Server) -> None:
    docs, asked = beside(), list[str]()
    docs.on("request", lambda request: asked.append(request.url))
    view(page, "API")
    docs.goto(page.get_by_role("link", name="All calls").evaluate("link => link.href"))
    call = docs.locator("#operations-catalogue-health")
    call.click()
    call.get_by_role("button", name="Try it out").click()
    call.get_by_role("button", name="Execute").click()
    expect(call.get_by_text('"status": "healthy"').first).to_be_visible()
    assert [url for url in asked if not url.startswith((server.url, "data:", "blob:"))] == []


@pytest.mark.feature("D1")
def test_the_logs_show_requests_training_and_flights_as_they_come(page: Page, server: Server, data: Path) -> None:
    view(page, "API")
    requests, training, flights = (page.get_by_role("log", name=name) for name in ("Requests", "Training", "Flights"))
    expect(requests).to_contain_text("GET /tasks 200")
    server.client.get("/grade/nowhere")
    expect(requests.get_by_text("/grade/nowhere")).to_have_count(1)
    for line in TRAINING:
        expect(training.get_by_text(line, exact=True)).to_be_visible()
    with (data / "train.log").open("a", encoding="utf-8") as file:
        file.write("episode 4 reward 9.99\n")
    expect(training.get_by_text("episode 4 reward 9.99", exact=True)).to_be_visible()
    assert MARKUP in training.inner_text()
    expect(flights.get_by_role("listitem").first).to_be_visible()
    with DroneEnvClient(server.url) as client:
        observation = client.reset("easy", seed=4242, agent="random")
        while not observation["done"]:
            observation = client.step("WAIT")
    line = flights.get_by_role("listitem").filter(has_text="Easy, map 4242, Random")
    expect(line).to_contain_text("Battery empty, 60 steps")
    line.get_by_role("link", name="Open the flight").click()
    expect(page).to_have_url(re.compile(r"\?episode=\w+$"))
    expect_step(page, 0, 60)
