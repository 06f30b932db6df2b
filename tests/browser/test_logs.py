"""The logs: requests, training and flights, as they come."""

from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from drone_env.client import DroneEnvClient
from tests.api.serving import Server
from tests.browser.conftest import MARKUP, TRAINING
from tests.browser.stage import view


@pytest.mark.feature("D1")
def test_requests_appear_as_they_are_answered(page: Page, server: Server) -> None:
    view(page, "Logs")
    log = page.get_by_role("log", name="Requests")
    expect(log).to_contain_text("GET /tasks 200")
    httpx.get(f"{server.url}/grade/nowhere")
    expect(log.get_by_text("/grade/nowhere")).to_have_count(1)


@pytest.mark.feature("D1")
def test_training_lines_appear_as_they_are_written(page: Page, data: Path) -> None:
    view(page, "Logs")
    log = page.get_by_role("log", name="Training")
    for line in TRAINING:
        expect(log.get_by_text(line, exact=True)).to_be_visible()
    with (data / "train.log").open("a", encoding="utf-8") as file:
        file.write("episode 4 reward 9.99\n")
    expect(log.get_by_text("episode 4 reward 9.99", exact=True)).to_be_visible()
    assert MARKUP in log.inner_text()


def test_flights_that_end_appear_and_can_be_replayed(page: Page, server: Server) -> None:
    view(page, "Logs")
    log = page.get_by_role("log", name="Flights")
    expect(log.get_by_role("listitem").first).to_be_visible()
    with DroneEnvClient(server.url) as client:
        observation = client.reset("easy", seed=4242)
        while not observation["done"]:
            observation = client.step("WAIT")
    line = log.get_by_role("listitem").filter(has_text="Easy Delivery 4242")
    expect(line).to_contain_text("Battery empty, 60 steps")
    line.get_by_role("button", name="Replay").click()
    expect(page.get_by_role("heading", name="Easy Delivery, map 4242")).to_be_visible()
