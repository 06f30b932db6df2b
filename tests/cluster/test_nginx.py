"""Several servers behind nginx, with `deploy/nginx.conf`: one is killed."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import httpx
import pytest

from drone_env.client import DroneEnvClient
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from tests.cluster.serving import Cluster, Nginx
from tests.tools import reserved_port

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    folder = tmp_path_factory.mktemp("cluster")
    with closing(Cluster(folder, 3, CAPACITY="1000", ALLOWED_HOSTS="drone.example")) as found:
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


def test_a_killed_server_loses_no_step(running: Cluster) -> None:
    with ExitStack() as opened:
        clients = [opened.enter_context(DroneEnvClient(running.url)) for _ in range(12)]
        episodes = [Episode("hard", seed=seed) for seed in range(len(clients))]
        for client, episode in zip(clients, episodes, strict=True):
            client.reset("hard", seed=episode.seed)
        for step in range(12):
            if step == 6:
                killed = max(running.servers, key=lambda port: running.answered(port, "/step", 0))
                running.servers[killed].kill()
            for client, episode in zip(clients, episodes, strict=True):
                action = Action((step + episode.seed) % 5)
                episode.step(action)
                flown = client.step(action.name)
                assert (flown["step_count"], flown["drone_x"], flown["drone_y"]) == (episode.steps, *episode.position)
        running.start(killed)


def test_where_no_server_answers_that_is_told_as_json(tmp_path: Path) -> None:
    with closing(Nginx(tmp_path, [reserved_port()])) as nginx:
        answer = httpx.post(f"{nginx.url}/step", json={"direction": "UP"}, headers={"X-Step-Count": "0"})
    assert (answer.status_code, answer.json()["code"]) == (502, "no_server")
    assert answer.headers["Retry-After"] == "1"
