"""Several servers behind nginx, with `deploy/nginx.conf`: one is killed."""

import asyncio
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from tests.cluster.serving import Cluster, Nginx
from tests.cluster.sessions import Client, HttpSession, SocketSession, fly_all
from tests.tools import reserved_port

SERVERS = 3
SESSIONS = int(os.environ.get("DRONE_ENV_NGINX_SESSIONS", "12"))
"""Of each kind; as many as the servers share equally."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    folder = tmp_path_factory.mktemp("cluster")
    with closing(Cluster(folder, SERVERS, CAPACITY="1000", ALLOWED_HOSTS="drone.example")) as found:
        yield found


def test_callers_see_a_server(running: Cluster) -> None:
    with httpx.Client(base_url=running.url) as client:
        opened = client.post("/reset", json={"seed": 7}, headers={"X-Forwarded-Proto": "https"})
        assert "Secure" not in opened.headers["Set-Cookie"]  # what nginx knows counts, not what callers say
        assert "nginx/" not in opened.headers["Server"]
        assert opened.headers["X-Content-Type-Options"] == "nosniff"
        # The cookie is enough to be found again.
        steps = [client.post("/step", json={"direction": "WAIT"}).json()["step_count"] for _ in range(9)]
        assert steps == list(range(1, 10))
        # To the servers all callers are nginx, of their own machine: strangers, who do not share a session.
        client.cookies.clear()
        client.post("/reset")
        client.cookies.clear()
        assert client.post("/step", json={"direction": "WAIT"}).json()["code"] == "no_session"
        too_large = client.post("/reset", content=b" " * 200_000, headers={"Content-Type": "application/json"})
        assert (too_large.status_code, too_large.json()["code"]) == (413, "too_large")
        assert client.get("/health", headers={"Host": "drone.example"}).status_code == 200
        assert client.get("/health", headers={"Host": "elsewhere.example"}).json()["code"] == "host"
        own, foreign = running.url, "http://elsewhere.example"
        assert client.get("/tasks", headers={"Origin": own}).status_code == 200
        assert client.get("/tasks", headers={"Origin": foreign}).json()["code"] == "origin"


def test_a_session_stays_with_its_server(running: Cluster) -> None:
    with httpx.Client(base_url=running.url) as client:
        before = {port: running.latest(port) for port in running.servers}
        session = {"X-Session-Id": client.post("/reset").json()["session_id"]}
        for _ in range(9):
            client.get("/path_history", headers=session)
        answered = [running.answered(port, "/path_history", since) for port, since in before.items()]
    assert sorted(answered) == [0, 0, 9]


def test_new_sessions_are_opened_by_all_servers(running: Cluster) -> None:
    before = {port: running.latest(port) for port in running.servers}
    with httpx.Client(base_url=running.url, headers={"X-Session-Id": "new"}) as client:
        assert len({client.post("/reset").json()["session_id"] for _ in range(30)}) == 30
    assert max(running.answered(port, "/reset", since) for port, since in before.items()) < 30


async def busiest(running: Cluster, http: list[HttpSession]) -> int:
    """Fly one step; the server that most of these sessions go to, which is decided by chance."""
    before = {port: running.latest(port) for port in running.servers}
    await fly_all(http, 1)
    return max(before, key=lambda port: running.answered(port, "/step", before[port]))


async def until_answered(running: Cluster, port: int, path: str, since: int, count: int) -> None:
    """Wait until a server has answered exactly so many; a WebSocket counts a little after its client has closed it."""
    for _ in range(300):
        if running.answered(port, path, since) == count:
            return
        await asyncio.sleep(0.1)
    pytest.fail(f"{running.answered(port, path, since)} of {count} requests for {path} were answered")


async def fly_until_used(running: Cluster, port: int, http: list[HttpSession]) -> None:
    """Fly on until the sessions of a server that has come back go to it again."""
    for _ in range(60):
        await fly_all(http, 1)
        if running.answered(port, "/step"):
            return
        await asyncio.sleep(1)
    pytest.fail("the server that came back is not used")


@pytest.mark.long
def test_a_server_is_killed_among_its_sessions_and_comes_back(running: Cluster) -> None:
    async def all_of_it() -> None:
        async with Client(running.url) as client:
            # Every tenth does not say which step it sends.
            http = [HttpSession(client, seed, counts=seed % 10 > 0) for seed in range(SESSIONS)]
            sockets = [SocketSession(running.url, 1000 + seed) for seed in range(SESSIONS)]
            await asyncio.gather(*[session.open() for session in http])
            for session in sockets:
                await session.open()
            killed, steps = await busiest(running, http), 0

            def kill_in_the_middle() -> None:
                nonlocal steps
                steps += 1
                if steps == 2 * SESSIONS * 3:
                    running.servers[killed].kill()

            await asyncio.gather(fly_all(http, 6, kill_in_the_middle), fly_all(sockets, 12, kill_in_the_middle))
            assert running.servers[killed].process.poll() is not None
            await asyncio.gather(*[session.check() for session in http])
            # A server that dies while it sends a response breaks that connection; a session has one request at a time.
            assert all(session.broken <= 1 for session in http)
            # Those of the killed server, a third of them, and no other.
            lost = [session for session in sockets if session.lost]
            assert len(lost) == SESSIONS // SERVERS

            running.start(killed)
            again = [SocketSession(running.url, 2000 + seed) for seed in range(len(lost))]
            await fly_until_used(running, killed, http)
            for session in again:
                await session.open()
            whole = [session for session in sockets if not session.lost] + again
            await asyncio.gather(fly_all(whole, 2), *[session.check() for session in http])
            assert not [session for session in whole if session.lost]
            before = running.latest(killed)
            await asyncio.gather(*[session.close() for session in again])
            await until_answered(running, killed, "/ws", before, len(again))  # it had the fewest
            await asyncio.gather(*[session.close() for session in whole])

    asyncio.run(all_of_it())


def test_where_no_server_answers_that_is_told_as_json(tmp_path: Path) -> None:
    with closing(Nginx(tmp_path, [reserved_port()])) as nginx:
        answer = httpx.post(f"{nginx.url}/step", json={"direction": "UP"}, headers={"X-Step-Count": "0"})
    assert (answer.status_code, answer.json()["code"]) == (502, "no_server")
    assert answer.headers["Retry-After"] == "1"
