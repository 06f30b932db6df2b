"""A repeated step with the same `X-Step-Count` is flown once."""

from typing import Any

import httpx
import pytest
from starlette.testclient import TestClient

from drone_env.client import DroneEnvClient, ServerError
from drone_env.server.routes.flight import COOKIE

Header = dict[str, str]


def step(client: TestClient, session: Header, direction: str, after: object) -> Any:
    return client.post("/step", json={"direction": direction}, headers={**session, "X-Step-Count": str(after)})


def test_it_is_answered_alike_by_both_ways_through_the_server(client: TestClient, session: Header) -> None:
    body = {"direction": "UP"}
    plain = client.post("/step", json=body, headers={**session, "X-Step-Count": "0"})
    unusual = client.post("/step", json=body, headers={**session, "X-Step-Count": "000"})
    assert plain.status_code == 200
    assert plain.content == unusual.content
    assert sorted(plain.headers.items()) == sorted(unusual.headers.items())
    cookie = {"Cookie": f"{COOKIE}={session['X-Session-Id']}", "X-Step-Count": "0"}
    assert client.post("/step", json=body, headers=cookie).content == plain.content
    assert client.post("/step", json=body, headers={**cookie, "X-Session-Id": "another"}).status_code == 410


def test_so_is_the_last_step_of_an_episode(client: TestClient) -> None:
    session = {"X-Session-Id": client.post("/reset", json={"seed": 14}).json()["session_id"]}
    for count, direction in enumerate(("LEFT", "UP", "UP")):
        answers = [step(client, session, direction, count).json() for _ in range(2)]
        assert answers[0] == answers[1]
    assert answers[0]["done"]
    assert step(client, session, "UP", 3).json()["reward_last"] == 0
    assert step(client, session, "UP", 2).json() == answers[0], "a step after the end went before"
    assert len(client.get("/memory_logs").json()["episodes"]) == 1


@pytest.mark.parametrize(("direction", "after"), [("DOWN", 0), ("UP", 2), ("UP", 7)])
def test_a_step_that_follows_another_one_is_refused_and_changes_nothing(
    client: TestClient, session: Header, direction: str, after: int
) -> None:
    step(client, session, "UP", 0)
    answer = step(client, session, direction, after)
    assert (answer.status_code, answer.json()["code"]) == (409, "wrong_moment")
    assert f"X-Step-Count is {after}, but the session has flown 1 steps" in answer.json()["detail"]
    assert client.get("/state", headers=session).json()["step_count"] == 1


class LosesAnswers:
    """A client whose connection closes before the first answer on each path."""

    def __init__(self, client: TestClient) -> None:
        self.client = client
        self.sent: list[str] = []

    def request(self, method: str, path: str, **what: Any) -> Any:
        answer = self.client.request(method, path, **what)
        self.sent.append(path)
        if self.sent.count(path) == 1:
            raise httpx.RemoteProtocolError("Server disconnected without sending a response.")
        return answer


def test_the_client_sends_again_what_met_a_closed_connection_where_that_is_harmless(client: TestClient) -> None:
    http = LosesAnswers(client)
    with DroneEnvClient(http=http) as drone:
        with pytest.raises(ServerError, match="Server disconnected"):
            drone.reset("hard", seed=7)
        drone.reset("hard", seed=7)
        assert [drone.step("WAIT")["step_count"] for _ in range(2)] == [1, 2]
    assert http.sent[:5] == ["/reset", "/reset", "/step", "/step", "/step"]
