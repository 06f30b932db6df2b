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
    with closing(Cluster(folder, 3, CAPACITY="1000")) as found:
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
        own, foreign = running.url, "http://elsewhere.example"
        assert client.get("/tasks", headers={"Origin": own}).status_code == 200
        assert client.get("/tasks", headers={"Origin": foreign}).json()["code"] == "origin"


def test_a_session_stays_with_its_server_and_all_servers_open_sessions(running: Cluster) -> None:
    new = {"X-Session-Id": "new"}
    with httpx.Client(base_url=running.url) as client:
        sessions = {client.post("/reset", headers=new).json()["session_id"] for _ in range(30)}
        for _ in range(9):
            client.get("/path_history", headers={"X-Session-Id": min(sessions)})
    assert len(sessions) == 30
    assert sorted(running.answered("/path_history").values()) == [0, 0, 9]
    assert min(running.answered("/reset").values()) > 0


def test_a_killed_server_loses_no_step(running: Cluster) -> None:
    with ExitStack() as opened:
        clients = [opened.enter_context(DroneEnvClient(running.url)) for _ in range(12)]
        episodes = [Episode("hard", seed=seed) for seed in range(len(clients))]
        for client, episode in zip(clients, episodes, strict=True):
            client.reset("hard", seed=episode.seed)
        for step in range(12):
            if step == 6:
                answered = running.answered("/step")
                killed = max(answered, key=answered.__getitem__)
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
