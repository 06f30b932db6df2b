"""Clients of the server: flat JSON over HTTP, and OpenEnv over WebSocket.

    with DroneEnvClient("http://localhost:8000") as client:
        observation = client.reset("hard_delivery", seed=7)
        while not observation["done"]:
            observation = client.step("RIGHT")

`DroneDeliveryClient` is the OpenEnv client; it is imported when it is first asked for, because OpenEnv takes seconds.
`python -m drone_env.client URL` flies one map as a check.
"""

import argparse
import os
import random
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.errors import DroneEnvError, needs

with needs("server", __name__):
    import httpx

if TYPE_CHECKING:
    from drone_env.openenv_client import DroneDeliveryClient as DroneDeliveryClient

__all__ = ["DroneDeliveryClient", "DroneEnvClient", "ServerError"]

DEFAULT_URL = "http://localhost:8000"
BROKEN = (httpx.ReadError, httpx.RemoteProtocolError, httpx.WriteError)


class ServerError(DroneEnvError):
    """The server did not do what was asked.

    Attributes:
        status: The HTTP status, 0 where there was no answer.
        code: What went wrong, for programs.
    """

    def __init__(self, status: int, code: str, message: str) -> None:
        self.status = status
        self.code = code
        super().__init__(message)


class DroneEnvClient:
    """One session of the server over HTTP. Observations and answers are dictionaries, as the server's JSON has them.

    Args:
        base_url: Where the server is.
        timeout: Seconds that an answer may take.
        token: The server's token, if it asks for one; `DRONE_ENV_TOKEN` of the environment without one.
        http: A client to send with instead, such as Starlette's `TestClient`, which needs no network; the other
            arguments are then its affair, and so is closing it.
    """

    def __init__(
        self, base_url: str = DEFAULT_URL, timeout: float = 30.0, token: str | None = None, http: Any = None
    ) -> None:
        token = token or os.environ.get("DRONE_ENV_TOKEN")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._owns = http is None
        self._http = http or httpx.Client(base_url=base_url, timeout=timeout, headers=headers)
        self.session_id: str | None = None
        """The session; set it to go on with another client's."""
        self._known: dict[str | None, int] = {}  # the session that was reset here, and its step_count

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self, keep_session: bool = False) -> None:
        """Close the connection, and end the session.

        Args:
            keep_session: Leave the session on the server, for a client that is given its `session_id`.
        """
        if self.session_id is not None and not keep_session:
            # A server that cannot be reached ends it by itself, when it has been idle for too long.
            with suppress(ServerError):
                self.end_session()
        if self._owns:
            self._http.close()

    def health(self) -> dict[str, Any]:
        """Whether the server is well, and its version."""
        return self._call("GET", "/health")

    def tasks(self) -> dict[str, Any]:
        """All tasks and reward profiles."""
        return self._call("GET", "/tasks")

    def reset(
        self,
        task_name: str | None = None,
        seed: int | None = None,
        reward_profile: str | None = None,
        agent: str | None = None,
    ) -> dict[str, Any]:
        """Start an episode and return its first observation. What is left out is chosen by the server.

        Args:
            task_name: Id, short name or grader of the task.
            seed: Number of the map.
            reward_profile: What steps pay.
            agent: Who flies, for the records.
        """
        given = {"task_name": task_name, "seed": seed, "reward_profile": reward_profile, "agent": agent}
        answer = self._call("POST", "/reset", {name: value for name, value in given.items() if value is not None})
        self.session_id = str(answer.pop("session_id"))
        self._known = {self.session_id: answer["step_count"]}
        return answer

    def step(self, direction: str) -> dict[str, Any]:
        """Fly one action, `UP`, `DOWN`, `LEFT`, `RIGHT` or `WAIT`, and return the observation.

        In a session that this client has reset, an action whose answer was lost may be sent again: it is flown once. If
        another client has stepped the session meanwhile, the step is refused; `state` brings this one up to date.
        """
        count = self._known.get(self.session_id)
        more = None if count is None else {"X-Step-Count": str(count)}
        return self._noted(self._call("POST", "/step", {"direction": direction}, more))

    def end_session(self) -> None:
        """End the session, so that its place on the server is free. An episode that has not ended is dropped."""
        self._call("DELETE", "/session")
        self.session_id = None

    def state(self) -> dict[str, Any]:
        """The full state of the episode."""
        return self._noted(self._call("GET", "/state"))

    def grade(self, task_name: str) -> dict[str, Any]:
        """The graded score of the episode, which must be of this task."""
        return self._call("GET", f"/grade/{task_name}")

    def analyse(self, task_name: str) -> dict[str, Any]:
        """Figures of the finished episodes of a task."""
        return self._call("GET", f"/analyse/{task_name}")

    def path_history(self) -> dict[str, Any]:
        """The flight so far."""
        return self._call("GET", "/path_history")

    def solution(self) -> dict[str, Any]:
        """The best flight over the map, once the episode has ended."""
        return self._call("GET", "/solution")

    def predict(self) -> dict[str, Any]:
        """What the trained network would do now."""
        return self._call("POST", "/predict")

    def run_random_episode(self, task: str = "easy_delivery", verbose: bool = False) -> dict[str, Any]:
        """Fly one episode with random actions.

        Args:
            task: The task.
            verbose: Print every step.

        Returns:
            The last observation, with `task` and `steps`.
        """
        observation = self.reset(task, agent="random")
        while not observation["done"]:
            direction = random.choice([action.name for action in Action])
            observation = self.step(direction)
            if verbose:
                print(
                    f"step {observation['step_count']}: {direction} reward {observation['reward_last']:.2f} "
                    f"delivered {observation['deliveries_done']}/{observation['deliveries_total']}"
                )
        return {"task": task, "steps": observation["step_count"], **observation}

    def _noted(self, answer: dict[str, Any]) -> dict[str, Any]:
        if self.session_id in self._known:
            self._known[self.session_id] = answer["step_count"]
        return answer

    def _call(
        self, method: str, path: str, body: dict[str, Any] | None = None, more: dict[str, str] | None = None
    ) -> dict[str, Any]:
        """Send a request and return its JSON. Where the connection breaks, it is sent once more if that is harmless.

        Args:
            method: GET is harmless.
            path: Where to.
            body: To be sent as JSON.
            more: Headers of a request that is harmless to send twice.

        Raises:
            ServerError: if there is no answer, one that tells a problem, or one that is not a JSON object.
        """
        # Callers that name no session share one.
        headers = {"X-Session-Id": self.session_id or "new", **(more or {})}
        try:
            try:
                response = self._http.request(method, path, json=body, headers=headers)
            except BROKEN:
                # The other side had closed the connection while it lay idle, as nginx does when it is reloaded.
                if method != "GET" and more is None:
                    raise
                response = self._http.request(method, path, json=body, headers=headers)
        except httpx.HTTPError as error:
            raise ServerError(0, "no_answer", f"{method} {path}: {error or type(error).__name__}") from error
        answer: Any = None
        with suppress(ValueError):
            answer = {} if response.status_code == httpx.codes.NO_CONTENT else response.json()
        found = cast(dict[str, Any], answer) if isinstance(answer, dict) else {"detail": response.text[:200]}
        if response.is_success and found is answer:
            return found
        message = f"{method} {path}: {response.status_code}: {found.get('detail', '')}"
        raise ServerError(response.status_code, found.get("code", "http"), message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly one map at random against a server and print the result; 0 if all answers came, 1 otherwise."""
    parser = argparse.ArgumentParser("python -m drone_env.client", description="Check a server by flying one map.")
    parser.add_argument("url", nargs="?", default=DEFAULT_URL, help="where the server is (%(default)s)")
    parser.add_argument("--task", default="easy_delivery", help="the task to fly (%(default)s)")
    given = parser.parse_args(arguments)
    try:
        with DroneEnvClient(given.url) as client:
            print(f"health: {client.health()}")
            result = client.run_random_episode(given.task, verbose=True)
            print(f"grade: {client.grade(given.task)}")
            analysis = client.analyse(given.task)
        print(f"episodes of {analysis['task']} on this server: {analysis['episodes_total']}")
        print(f"score: {result['score']:.4f} in {result['steps']} steps")
    except (DroneEnvError, httpx.InvalidURL) as error:
        print(f"drone_env.client: {error}", file=sys.stderr)
        return 1
    return 0


def __getattr__(name: str) -> Any:
    if name == "DroneDeliveryClient":
        from drone_env.openenv_client import DroneDeliveryClient

        return DroneDeliveryClient
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if __name__ == "__main__":
    sys.exit(main())
