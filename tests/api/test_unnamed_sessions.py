"""Callers without a session id share the session of their address, except with a token or behind a proxy."""

from collections.abc import Generator
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.client import DroneEnvClient, ServerError
from drone_env.server.addresses import shared_address
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.api.conftest import NO_COOKIES

UP = {"direction": "UP"}


class TestUnnamed:
    """Programs that name no session: curl without a cookie jar, `requests.post`."""

    HERE = "127.0.0.1"

    @pytest.fixture
    def plain(self, settings: dict[str, Any], request: pytest.FixtureRequest) -> Generator[TestClient, None, None]:
        """One who calls a server; its other settings can be given indirectly."""
        app = create_app(Settings(**settings, **getattr(request, "param", {})))
        with TestClient(app, f"http://{self.HERE}:8000", client=(self.HERE, 5000)) as client:
            client.cookies.jar.set_policy(NO_COOKIES)
            yield client

    @pytest.mark.feature("H2", "H3", "H4", "H6")
    def test_they_fly_one_session_which_the_answers_name(self, plain: TestClient) -> None:
        opened = plain.post("/reset", json={"seed": 14})
        session = opened.json()["session_id"]
        answers = [opened]
        for direction in ("LEFT", "UP", "UP"):
            answers.append(plain.post("/predict"))
            answers.append(plain.post("/step", json={"direction": direction}))
        assert answers[-1].json()["done"]
        for path in ("/state", "/grade/easy", "/path_history"):
            answers.append(plain.get(path))
        assert answers[-4].json()["step_count"] == 3
        assert {(answer.status_code, answer.headers["X-Session-Id"]) for answer in answers} == {(200, session)}
        assert plain.post("/reset").json()["session_id"] == session
        assert plain.delete("/session").status_code == 204
        assert plain.get("/state").status_code == 409

    def test_a_session_that_somebody_names_is_shared_with_nobody(self, plain: TestClient) -> None:
        def step(session: str) -> int:
            header = {"X-Session-Id": session} if session else {}
            return plain.post("/step", json=UP, headers=header).json()["step_count"]

        # A map on which three steps do not end the flight.
        first, second = (plain.post("/reset", json={"seed": 7}).json()["session_id"] for _ in range(2))
        assert [step(first), step(second), step(second)] == [1, 1, 2]
        assert plain.post("/step", json=UP).status_code == 409
        shared = plain.post("/reset", json={"seed": 7}).json()["session_id"]
        assert [step(""), step(first), step(""), step(shared)] == [1, 2, 2, 3]
        assert plain.post("/step", json=UP).status_code == 409, "the shared one is named by now"
        # Nor is one found that was left before.
        assert plain.get("/state").status_code == 409
        # So is the session that somebody has opened and not flown yet: the next to name none gets another.
        assert len({plain.post("/reset").json()["session_id"] for _ in range(3)}) == 3

    def test_our_client_shares_with_nobody(self, plain: TestClient) -> None:
        plain.post("/reset")
        plain.post("/step", json=UP)
        with DroneEnvClient(http=plain) as one, DroneEnvClient(http=plain) as other:
            with pytest.raises(ServerError, match="names no session"):
                one.step("UP")
            for drone in (one, other):
                drone.reset(seed=7)
            assert [one.step("UP")["step_count"], other.step("UP")["step_count"]] == [1, 1]

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("X-Forwarded-For", "127.0.0.1"),
            ("Origin", "http://127.0.0.1:8000"),
            ("X-Session-Id", "new"),
        ],
    )
    def test_browsers_and_what_comes_through_a_proxy_have_to_name_one(
        self, plain: TestClient, name: str, value: str
    ) -> None:
        header = {name: value}
        plain.post("/reset")
        assert plain.post("/step", json=UP).status_code == 200
        refused = plain.post("/step", json=UP, headers=header)
        assert (refused.status_code, refused.json()["code"]) == (409, "no_session")
        assert "X-Session-Id: SESSION_ID" in refused.json()["detail"]
        plain.post("/reset", headers=header)
        assert plain.get("/state").json()["step_count"] == 1, "it has a session of its own"

    @pytest.mark.parametrize("plain", [{"token": "secret"}], indirect=True)
    def test_with_a_token_requests_need_a_session_id(self, plain: TestClient) -> None:
        token = {"Authorization": "Bearer secret"}
        assert plain.post("/reset", headers=token).status_code == 200
        assert plain.post("/step", json=UP, headers=token).status_code == 409

    def test_http_1_0_counts_as_a_proxy(self) -> None:
        scope: dict[str, Any] = {"client": (self.HERE, 5000), "headers": []}
        assert [shared_address(scope | {"http_version": version}) for version in ("1.1", "1.0")] == [self.HERE, None]
