"""Several worker processes on one data folder."""

import os
import re
import signal
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from drone_env.client import DroneEnvClient
from drone_env.core.episode import Episode
from drone_env.planning.optimal import solve
from tests.api.serving import Server, serving
from tests.api.test_stalled_readers import MOST, connected, pushed


@pytest.mark.long
def test_several_workers_serve_one_session_and_end_when_the_first_process_is_asked_to(tmp_path: Path) -> None:
    with serving(tmp_path / "data", ("drone_env/server/app.py", "--workers", "2")) as server:
        steps_over_many_connections_follow_each_other(server)
        concurrent_steps_are_flown_one_after_another(server)
        with ExitStack() as opened:
            for _ in range(2):
                assert pushed(opened.enter_context(connected(server)), b"GET /x HTTP/1.1\r\nHost: h\r\n\r\n") < MOST
            server.process.terminate()
            assert server.process.wait(timeout=60) == 0
        told = server.log.read_text().splitlines()
        assert [line for line in told if not re.fullmatch(r"drone-env.*(docs at|flies by).*", line)] == []
        assert told


@pytest.mark.skipif(sys.platform != "linux", reason="this system does not tell the children of a process")
def test_workers_end_with_the_first_process_however_that_ends(
    tmp_path: Path, eventually: Callable[[Callable[[], bool]], None]
) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        workers = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text().split()
        assert len(workers) >= 2
        server.kill()
        port = int(server.url.rpartition(":")[2])
        try:
            eventually(lambda: not is_taken(port))
            # A process that is not yet waited for has ended, too.
            eventually(lambda: all(state_of(worker) in ("", "Z") for worker in workers))
        finally:
            for worker in workers:
                if state_of(worker) not in ("", "Z"):
                    os.kill(int(worker), signal.SIGKILL)


def is_taken(port: int) -> bool:
    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", port)) == 0


def state_of(process: str) -> str:
    """The state of a process, empty if there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""


def steps_over_many_connections_follow_each_other(workers: Server) -> None:
    expected = Episode("hard", "tiered")
    expected.reset(7)
    opener = DroneEnvClient(workers.url)
    opener.reset("hard", seed=7)
    opener.close(keep_session=True)
    for action in solve("hard", 7).actions:
        # A connection for each step, so that both workers get some.
        client = DroneEnvClient(workers.url)
        client.session_id = opener.session_id
        observation = client.step(action.name)
        client.close(keep_session=True)
        expected.step(action)
        assert (observation["step_count"], observation["reward_total"]) == (expected.steps, expected.reward_total)
    assert observation["done"]


def concurrent_steps_are_flown_one_after_another(workers: Server) -> None:
    opener = DroneEnvClient(workers.url)
    opener.reset("hard", seed=7)
    opener.close(keep_session=True)
    seen: list[int] = []

    def wait_ten_times() -> None:
        client = DroneEnvClient(workers.url)
        client.session_id = opener.session_id
        seen.extend(client.step("WAIT")["step_count"] for _ in range(10))
        client.close(keep_session=True)

    threads = [threading.Thread(target=wait_ten_times) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(seen) == list(range(1, 81))
