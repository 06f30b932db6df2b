"""Several processes that serve one data folder."""

import os
import signal
import socket
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from drone_env.client import DroneEnvClient
from tests.api.serving import serving


@pytest.mark.skipif(sys.platform != "linux", reason="this system does not tell the children of a process")
def test_workers_fly_one_session_and_end_with_the_first_process_however_that_ends(
    tmp_path: Path, eventually: Callable[[Callable[[], bool]], None]
) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        workers = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text().split()
        assert len(workers) >= 2
        assert sorted(concurrent_steps(server.url)) == list(range(1, 81))
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


def concurrent_steps(url: str) -> list[int]:
    """The counts that eight clients of one session get for ten steps each."""
    opener = DroneEnvClient(url)
    opener.reset("hard", seed=7)
    opener.close(keep_session=True)

    def wait_ten_times() -> list[int]:
        client = DroneEnvClient(url)
        client.session_id = opener.session_id
        counts = [client.step("WAIT")["step_count"] for _ in range(10)]
        client.close(keep_session=True)
        return counts

    with ThreadPoolExecutor(8) as pool:
        waiting = [pool.submit(wait_ten_times) for _ in range(8)]
    return [count for waited in waiting for count in waited.result()]


def is_taken(port: int) -> bool:
    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", port)) == 0


def state_of(process: str) -> str:
    """The state of a process, empty if there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""
