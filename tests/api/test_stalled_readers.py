"""The request log as a stream."""

import asyncio
import json
import re

import httpx
import pytest

from drone_env.server.logs import KEPT, RequestLog
from tests.api.serving import Server
from tests.tools import PATIENCE


@pytest.mark.feature("H9")
def test_the_request_log_is_streamed(server: Server) -> None:
    with (
        httpx.Client(base_url=server.url, timeout=PATIENCE) as http,
        http.stream("GET", "/terminal_logs", headers={"Accept": "text/event-stream"}) as live,
    ):
        assert live.headers["Content-Type"].startswith("text/event-stream")
        entries = (json.loads(line[6:]) for line in live.iter_lines() if line.startswith("data: "))
        http.get("/health?while=listening")
        before = http.get("/terminal_logs").json()["requests"][-1]["number"]
        http.get("/tasks?while=listening")
        later = next(one for one in entries if one["number"] > before and one["path"] == "/tasks")
        assert (later["method"], later["status"]) == ("GET", 200)


def test_followers_of_the_requests_skip_what_is_not_kept_any_more() -> None:
    log = RequestLog()

    def numbers(events: bytes) -> list[int]:
        return [int(number) for number in re.findall(rb"^id: (\d+)", events, re.MULTILINE)]

    async def follow() -> None:
        log.add("GET", "/first", 200, 0)
        reader = log.follow()
        assert numbers(await anext(reader)) == [1]
        for _ in range(5 * KEPT):
            log.add("GET", "/later", 200, 0)
        assert numbers(await anext(reader)) == [*range(log.count - KEPT + 1, log.count + 1)]

    asyncio.run(asyncio.wait_for(follow(), PATIENCE))
