"""The client of the server: JSON over HTTP.

    with DroneEnvClient("http://localhost:8000") as client:
        observation = client.reset("hard_delivery", seed=7)
        while not observation["done"]:
            observation = client.step("RIGHT")

The OpenEnv client is `drone_env.openenv_client.DroneDeliveryClient`.
`python -m drone_env.client URL` flies one map as a smoke test.
"""

import argparse
import os
import random
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, cast

from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.errors import DroneEnvError, InvalidValueError, needs

with needs("server", __name__):
    import httpx

DEFAULT_URL = "http://localhost:8000"
BROKEN = (httpx.ReadError, httpx.RemoteProtocolError, httpx.WriteError)


class ServerError(DroneEnvError):
    """A request failed.

    Attributes:
        status: The HTTP status; 0 without a response.
        code: The error code.
    """

    def __init__(self, status: int, code: str, message: str) -> None:
        self.status = status
        self.code = code
        super().__init__(message)


class DroneEnvClient:
    """One session of the server over HTTP. Methods return the JSON of the response as a dictionary.

    All methods raise `ServerError` if the server cannot be reached or returns an error.

    Args:
        base_url: URL of the server.
        timeout: Timeout of a request in seconds.
        token: The server's token; default: the environment variable `DRONE_ENV_TOKEN`.
        http: An `httpx.Client` such as Starlette's `TestClient`, which replaces the other arguments. The caller closes
            it.
    """

    def __init__(
        self, base_url: str = DEFAULT_URL, timeout: float = 30.0, token: str | None = None, http: Any = None
    ) -> None:
        if not base_url.startswith(("http://", "https://")):
            raise InvalidValueError(f"base_url must begin with http:// or https://, got {base_url!r}")
        token = token or os.environ.get("DRONE_ENV_TOKEN")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._owns = http is None
        self._http = http or httpx.Client(base_url=base_url, timeout=timeout, headers=headers)
        self.session_id: str | None = None
        """The session id; set it to continue the session of another client."""
        self._step_counts: dict[str | None, int] = {}  # of the session that this client has reset

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self, keep_session: bool = False) -> None:
        """Close the connection, and end the session.

        Args:
            keep_session: Do not end the session, so that another client can continue it.
        """
        if self.session_id is not None and not keep_session:
            # The server also ends idle sessions.
            with suppress(ServerError):
                self.end_session()
        if self._owns:
            self._http.close()

    def health(self) -> dict[str, Any]:
        """Return the status and version of the server."""
        return self._call("GET", "/health")

    def tasks(self) -> dict[str, Any]:
        """Return all tasks and reward profiles."""
        return self._call("GET", "/tasks")

    def reset(
        self,
        task_name: str | None = None,
        seed: int | None = None,
        reward_profile: str | None = None,
        agent: str | None = None,
    ) -> dict[str, Any]:
        """Start an episode and return its first observation. The server chooses what is None.

        Args:
            task_name: Id, short name or grader of the task.
            seed: Number of the map.
            reward_profile: Id of the reward profile.
            agent: Name of the agent in the records.
        """
        options = {"task_name": task_name, "seed": seed, "reward_profile": reward_profile, "agent": agent}
        answer = self._call("POST", "/reset", {name: value for name, value in options.items() if value is not None})
        self.session_id = str(answer.pop("session_id"))
        self._step_counts = {self.session_id: answer["step_count"]}
        return answer

    def step(self, direction: str) -> dict[str, Any]:
        """Fly one action, `UP`, `DOWN`, `LEFT`, `RIGHT` or `WAIT`, and return the observation.

        In a session that this client has reset, a step whose response was lost is repeated, and flown once. If another
        client has stepped the session meanwhile, the server refuses the step; `state` updates the step count.
        """
        count = self._step_counts.get(self.session_id)
        headers = None if count is None else {"X-Step-Count": str(count)}
        return self._counted(self._call("POST", "/step", {"direction": direction}, headers))

    def end_session(self) -> None:
        """End the session. An episode that has not ended is dropped."""
        self._call("DELETE", "/session")
        self.session_id = None

    def state(self) -> dict[str, Any]:
        """Return the full state of the episode."""
        return self._counted(self._call("GET", "/state"))

    def grade(self, task_name: str) -> dict[str, Any]:
        """Return the graded score of the episode, which must be of this task."""
        return self._call("GET", f"/grade/{task_name}")

    def analyse(self, task_name: str) -> dict[str, Any]:
        """Return statistics of the finished episodes of a task."""
        return self._call("GET", f"/analyse/{task_name}")

    def path_history(self) -> dict[str, Any]:
        """Return the steps of the episode."""
        return self._call("GET", "/path_history")

    def predict(self) -> dict[str, Any]:
        """Return the next action by the trained network."""
        return self._call("POST", "/predict")

    def run_random_episode(self, task: str = "easy_delivery", verbose: bool = False) -> dict[str, Any]:
        """Fly one episode with random actions.

        Args:
            task: The task.
            verbose: Print every step.

        Returns:
            The last observation, and `task` and `steps`.
        """
        observation = self.reset(task, agent="random")
        while not observation["done"]:
            direction = random.choice([action.name for action in Action])
            observation = self.step(direction)
            if verbose:
                _print_step(direction, observation)
        return {"task": task, "steps": observation["step_count"], **observation}

    def _counted(self, answer: dict[str, Any]) -> dict[str, Any]:
        if self.session_id in self._step_counts:
            self._step_counts[self.session_id] = answer["step_count"]
        return answer

    def _call(
        self, method: str, path: str, body: dict[str, Any] | None = None, idempotency: dict[str, str] | None = None
    ) -> dict[str, Any]:
        """Send a request and return its JSON. After a broken connection an idempotent request is sent once more.

        Args:
            method: GET is idempotent.
            path: The path.
            body: The body, sent as JSON.
            idempotency: Headers that make another method idempotent.
        """
        # Without an id, callers would share a session.
        headers = {"X-Session-Id": self.session_id or "new", **(idempotency or {})}
        try:
            try:
                response = self._http.request(method, path, json=body, headers=headers)
            except BROKEN:
                # For example nginx closes idle connections when it is reloaded.
                if method != "GET" and idempotency is None:
                    raise
                response = self._http.request(method, path, json=body, headers=headers)
        except httpx.HTTPError as error:
            raise ServerError(0, "no_answer", f"{method} {path}: {error or type(error).__name__}") from error
        answer: Any = None
        with suppress(ValueError):
            answer = {} if response.status_code == httpx.codes.NO_CONTENT else response.json()
        fields = cast(dict[str, Any], answer) if isinstance(answer, dict) else {"detail": response.text[:200]}
        if response.is_success and fields is answer:
            return fields
        message = f"{method} {path}: {response.status_code}: {fields.get('detail', '')}"
        raise ServerError(response.status_code, fields.get("code", "http"), message)


def _print_step(direction: str, observation: dict[str, Any]) -> None:
    print(
        f"step {observation['step_count']}: {direction} reward {observation['reward_last']:.2f} "
        f"delivered {observation['deliveries_done']}/{observation['deliveries_total']}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly one map by the server's network and print the result; return 0, or 1 after an error."""
    parser = argparse.ArgumentParser("python -m drone_env.client", description="Check a server by flying one map.")
    parser.add_argument("url", nargs="?", default=DEFAULT_URL, help="URL of the server (%(default)s)")
    try:
        with DroneEnvClient(parser.parse_args(arguments).url) as client:
            print(f"health: {client.health()}")
            observation = client.reset("easy_delivery", agent="client")
            while not observation["done"]:
                direction = client.predict()["action"]
                observation = client.step(direction)
                _print_step(direction, observation)
            print(f"grade: {client.grade('easy_delivery')}")
            print(f"episodes of easy_delivery on this server: {client.analyse('easy_delivery')['episodes_total']}")
        print(f"score: {observation['score']:.4f} in {observation['step_count']} steps; the server works")
    except (DroneEnvError, httpx.InvalidURL) as error:
        print(f"drone_env.client: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    from drone_env.standard_output import guarded

    sys.exit(guarded(main))
