"""The server as a process: how it is started, what survives when it is killed, several at once, fuzzed frames."""

import asyncio
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import websockets
import websockets.exceptions
import websockets.sync.client

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS
from drone_env.episodes.record import replay
from drone_env.episodes.store import Store
from drone_env.planning.optimal import solve
from tests.api.serving import ROOT, Server, serving
from tests.tools import reserved_port

KILLS = int(os.environ.get("DRONE_ENV_KILLS", "4"))
FRAMES = int(os.environ.get("DRONE_ENV_FRAMES", "2000"))
SOCKETS = 256
STEPS = int(os.environ.get("DRONE_ENV_SOCKET_STEPS", "20000"))


@pytest.mark.parametrize(
    "command",
    [
        ("server/app.py",),
        ("-m", "uvicorn", "drone_env.server.app:app"),
        ("-m", "drone_env.cli", "serve"),
    ],
)
def test_every_other_way_to_start_it_starts_it(tmp_path: Path, command: tuple[str, ...]) -> None:
    with serving(tmp_path / "data", command) as server:
        smoke = subprocess.run(
            [sys.executable, "-m", "drone_env.client", server.url],
            capture_output=True,
            text=True,
            cwd=ROOT,
            check=False,
        )
        assert smoke.returncode == 0, smoke.stderr
        assert "score: " in smoke.stdout
        assert smoke.stdout.count("step ") <= 60


def test_it_answers_within_three_seconds_of_cpu_and_loads_neither_gradio_nor_openenv() -> None:
    code = (
        "import resource, sys, drone_env.commands.serve, drone_env.server.app as a; a.app\n"
        "assert not {'openenv', 'gradio', 'torch', 'fastmcp'} & set(sys.modules), 'too much is loaded'\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_utime)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert float(run.stdout) < 3


def test_the_smoke_flight_fails_where_there_is_no_server() -> None:
    command = [sys.executable, "-m", "drone_env.client", f"http://127.0.0.1:{reserved_port()}"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.returncode == 1
    assert run.stderr.startswith("drone_env.client: GET /health: ")


@pytest.mark.parametrize("command", [("drone_env/server/app.py",), ("-m", "drone_env.cli", "serve")])
@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"CAPACITY": "none"}, "DRONE_ENV_CAPACITY: "),
        ({"DATA": __file__, "WORKERS": "2"}, f"the data folder {__file__} cannot be used: "),
    ],
)
def test_a_wrong_setting_is_told_in_one_line(
    tmp_path: Path, command: tuple[str, ...], wrong: dict[str, str], told: str
) -> None:
    settings = {"DATA": str(tmp_path), "PORT": "0", **wrong}
    environment = {**os.environ, **{f"DRONE_ENV_{name}": value for name, value in settings.items()}}
    run = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, cwd=ROOT, env=environment, check=False, timeout=200
    )
    assert run.returncode != 0
    assert told in run.stderr
    assert len(run.stderr.splitlines()) == 1


class Pilot(threading.Thread):
    """Flies over HTTP without end, and knows what was acknowledged."""

    def __init__(self, url: str, number: int) -> None:
        super().__init__(daemon=True)
        self.client = DroneEnvClient(url)
        self.random = random.Random(number)
        self.number = number
        self.stop = False
        self.failure: BaseException | None = None
        self.expected: Episode | None = None
        self.pending: list[Action] = []
        """Sent, not acknowledged: may have been flown or not."""
        self.finished: list[tuple[int, float]] = []
        """(seed, score) of the episodes whose end was acknowledged."""

    def run(self) -> None:
        try:
            while not self.stop:
                self.once()
        except ServerError as error:
            if error.status:
                self.failure = error
        except BaseException as error:
            self.failure = error

    def once(self) -> None:
        if self.expected is None or self.expected.ended:
            seed = self.random.randrange(2**40) * 100 + self.number
            self.expected, self.pending = None, []
            self.client.reset("easy", seed=seed, agent="pilot")
            self.expected = Episode("easy")
            self.expected.reset(seed)
        best = solve("easy", self.expected.seed).actions
        flown = self.expected.steps
        action = best[flown] if flown < len(best) else Action.WAIT
        self.pending = [action]
        observation = self.client.step(action.name)
        self.pending = []
        self.expected.step(action)
        assert observation["step_count"] == self.expected.steps
        if observation["done"]:
            self.finished.append((self.expected.seed, observation["score"]))

    def check(self) -> None:
        """Hold the server's state against what was acknowledged, and go on from there."""
        if self.expected is None:
            return
        state = self.client.state()
        if state["seed"] != self.expected.seed:
            assert self.expected.ended, "an acknowledged episode is gone"
        ahead = state["step_count"] - self.expected.steps
        assert 0 <= ahead <= len(self.pending), "acknowledged steps are gone"
        for action in self.pending[:ahead]:
            self.expected.step(action)
        assert state["reward_total"] == self.expected.reward_total


def test_nothing_acknowledged_is_lost_when_the_server_is_killed(tmp_path: Path) -> None:
    data, port = tmp_path / "data", reserved_port()
    server = Server(["drone_env/server/app.py"], data, port, {})
    finished: list[tuple[int, float]] = []
    carried: list[Pilot] = [Pilot(server.url, number) for number in range(4)]
    moments = random.Random(1)
    try:
        for _ in range(KILLS):
            for pilot in carried:
                pilot.start()
            time.sleep(moments.uniform(0.2, 1.0))
            server.kill()
            for pilot in carried:
                pilot.join(30)
                assert pilot.failure is None, pilot.failure
            assert isinstance(json.loads((data / "memory.json").read_text(encoding="utf-8")), object)
            server = Server(["drone_env/server/app.py"], data, port, {})
            successors = []
            for pilot in carried:
                pilot.check()
                pilot.client.close(keep_session=True)
                finished += pilot.finished
                successor = Pilot(server.url, pilot.number)
                successor.client.session_id = pilot.client.session_id
                successor.random, successor.expected = pilot.random, pilot.expected
                successors.append(successor)
            carried = successors
    finally:
        server.kill()
        for pilot in carried:
            pilot.client.close(keep_session=True)
    assert finished
    with Store(data) as store:
        kept = {(stored.record.seed, stored.record.score): stored.record for stored in store.episodes()}
    for key in finished:
        assert replay(kept[key]).score == key[1]


def test_several_workers_serve_one_session(tmp_path: Path) -> None:
    with serving(tmp_path / "data", ("drone_env/server/app.py", "--workers", "2")) as server:
        expected = Episode("hard")
        expected.reset(7)
        opener = DroneEnvClient(server.url)
        opener.reset("hard", seed=7)
        opener.close(keep_session=True)
        for action in solve("hard", 7).actions:
            # A connection for each step, so that both workers get some.
            client = DroneEnvClient(server.url)
            client.session_id = opener.session_id
            observation = client.step(action.name)
            client.close(keep_session=True)
            expected.step(action)
            assert (observation["step_count"], observation["reward_total"]) == (expected.steps, expected.reward_total)
        assert observation["done"]


def test_a_worker_that_is_slow_for_a_while_is_not_replaced(tmp_path: Path) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        children = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children")
        if not children.exists():
            pytest.skip("this system does not tell the children of a process")
        before = children.read_text().split()
        for child in before:
            os.kill(int(child), signal.SIGSTOP)
        time.sleep(12)
        after = children.read_text().split()
        for child in after:
            os.kill(int(child), signal.SIGCONT)
        assert after == before


def test_concurrent_steps_of_one_session_are_flown_one_after_another(tmp_path: Path) -> None:
    with serving(tmp_path / "data", ("drone_env/server/app.py", "--workers", "2")) as server:
        opener = DroneEnvClient(server.url)
        opener.reset("hard", seed=7)
        opener.close(keep_session=True)
        seen: list[int] = []

        def wait_ten_times() -> None:
            client = DroneEnvClient(server.url)
            client.session_id = opener.session_id
            seen.extend(client.step("WAIT")["step_count"] for _ in range(10))
            client.close(keep_session=True)

        threads = [threading.Thread(target=wait_ten_times) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(seen) == list(range(1, 81))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(tmp_path_factory.mktemp("processes") / "data", CAPACITY="300") as running:
        yield running


def test_interleaved_sockets_never_see_each_other(server: Server) -> None:
    tasks = list(TASKS)[:3]

    async def fly(number: int, steps: int) -> int:
        moves = random.Random(number)
        episode = Episode(tasks[number % 3])
        url = server.url.replace("http", "ws") + "/ws"
        async with websockets.connect(url, compression=None, open_timeout=60) as socket:

            async def ask(kind: str, data: dict[str, Any] | None = None) -> Any:
                await socket.send(json.dumps({"type": kind} | ({} if data is None else {"data": data})))
                answer = json.loads(await socket.recv())
                assert answer["type"] != "error", answer
                return answer["data"]

            flown = 0
            seed = number
            while flown < steps:
                seed += SOCKETS
                await ask("reset", {"task_name": episode.task.id, "seed": seed, "episode_id": f"{number}"})
                episode.reset(seed)
                while not episode.ended and flown < steps:
                    action = Action(moves.randrange(5))
                    answer = await ask("step", {"direction": action.name})
                    reward = episode.step(action)
                    flown += 1
                    seen = answer["observation"]
                    assert (answer["reward"], seen["drone_x"], seen["drone_y"]) == (reward, *episode.position)
                    assert (seen["step_count"], answer["done"]) == (episode.steps, episode.ended)
                state = await ask("state")
                assert (state["seed"], state["episode_id"], state["step_count"]) == (seed, f"{number}", episode.steps)
            return flown

    async def all_of_them() -> list[int]:
        return await asyncio.gather(*[fly(number, -(-STEPS // SOCKETS)) for number in range(SOCKETS)])

    assert sum(asyncio.run(all_of_them())) >= STEPS


def frames(source: random.Random) -> Iterator[str | bytes]:
    """Frames that are nearly right, or not at all."""
    scalars: list[Any] = [None, True, 0, -1, 2**53, 1e308, 1.5, "", "UP", "\ud800", "\x00", [], {}, [[]], {"a": 1}]
    keys = ["type", "data", "direction", "seed", "task_name", "episode_id", "metadata", "split", "index", "agent", "x"]
    kinds = ["reset", "step", "state", "mcp", "RESET", "", None, 1, ["step"]]

    def value(depth: int) -> Any:
        pick = source.random()
        if depth and pick < 0.2:
            return {source.choice(keys): value(depth - 1) for _ in range(source.randrange(4))}
        if depth and pick < 0.3:
            return [value(depth - 1) for _ in range(source.randrange(4))]
        return source.choice(scalars)

    while True:
        frame: Any = {"type": source.choice(kinds), "data": {source.choice(keys): value(3) for _ in range(2)}}
        if source.random() < 0.2:
            frame = value(4)
        text = json.dumps(frame)
        pick = source.random()
        if pick < 0.1:
            text = text[: source.randrange(len(text) + 1)]
        elif pick < 0.15:
            text = text.replace("null", source.choice(["NaN", "Infinity", "-Infinity"]))
        elif pick < 0.17:
            text = "[" * source.randrange(20_000)
        elif pick < 0.2:
            yield os.urandom(source.randrange(50))
            continue
        yield text


def test_fuzzed_frames_neither_end_nor_stall_a_session(server: Server) -> None:
    url = server.url.replace("http", "ws") + "/ws"
    source = frames(random.Random(7))
    with websockets.sync.client.connect(url, compression=None) as socket:
        for number in range(FRAMES):
            socket.send(next(source))
            answer = json.loads(socket.recv(timeout=1))
            assert answer["type"] in ("observation", "state", "error", "mcp")
            if number % 100 == 0:
                socket.send('{"type": "reset", "data": {"seed": 7}}')
                assert json.loads(socket.recv(timeout=1))["type"] == "observation"
    assert httpx.get(f"{server.url}/health").status_code == 200
    assert "Traceback" not in server.log.read_text()


def test_an_oversized_frame_ends_its_connection_alone(server: Server) -> None:
    url = server.url.replace("http", "ws") + "/ws"
    with (
        websockets.sync.client.connect(url, compression=None) as other,
        websockets.sync.client.connect(url, compression=None) as socket,
    ):
        socket.send(" " * 100_000)
        with pytest.raises(websockets.exceptions.ConnectionClosedError) as closed:
            socket.recv(timeout=10)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009
        other.send('{"type": "reset"}')
        assert json.loads(other.recv(timeout=10))["type"] == "observation"


def test_the_request_log_is_streamed(server: Server) -> None:
    with httpx.stream(
        "GET", f"{server.url}/terminal_logs", headers={"Accept": "text/event-stream"}, timeout=30
    ) as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        httpx.get(f"{server.url}/tasks")
        for line in answer.iter_lines():
            if line.startswith("data: ") and json.loads(line.removeprefix("data: "))["path"] == "/tasks":
                break
