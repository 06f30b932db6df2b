"""Several server processes on one data folder."""

import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from drone_env.client import DroneEnvClient
from tests.api.serving import serving
from tests.tools import eventually, is_taken


@pytest.mark.skipif(sys.platform != "linux", reason="this system does not tell the children of a process")
def test_workers_fly_one_session_and_end_with_the_first_process_however_that_ends(tmp_path: Path) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        workers = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children").read_text().split()
        assert len(workers) >= 2
        assert sorted(concurrent_steps(server.client)) == list(range(1, 41))
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


def concurrent_steps(http: httpx.Client) -> list[int]:
    """Return the step counts that four clients of one session get for ten steps each."""
    opener = DroneEnvClient(http=http)
    opener.reset("hard", seed=7)

    def wait_ten_times(_: int) -> list[int]:
        client = DroneEnvClient(http=http)
        client.session_id = opener.session_id
        return [client.step("WAIT")["step_count"] for _ in range(10)]

    with ThreadPoolExecutor(4) as pool:
        return [count for counts in pool.map(wait_ten_times, range(4)) for count in counts]


def state_of(process: str) -> str:
    """The state of a process, empty if there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return ""
