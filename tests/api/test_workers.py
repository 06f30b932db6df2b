"""Several server processes on one data folder."""

import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from drone_env.client import DroneEnvClient
from tests.api.serving import serving
from tests.tools import eventually, is_taken

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform != "linux", reason="this system does not tell the children of a process"),
]


def test_they_end_when_the_first_process_is_killed(tmp_path: Path) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        workers = descendants(server.process.pid)
        assert len(workers) >= 2
        server.kill()
        eventually(lambda: not is_taken(int(server.url.rpartition(":")[2])))
        eventually(lambda: not any(map(is_running, workers)))


def test_one_that_is_killed_while_the_first_waits_for_it_is_started_again(tmp_path: Path) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        first = server.process.pid
        killed = next(filter(is_worker, descendants(first)))
        os.kill(killed, signal.SIGSTOP)
        eventually(lambda: "poll" in Path(f"/proc/{first}/wchan").read_text())
        os.kill(killed, signal.SIGKILL)
        since = time.monotonic()
        eventually(lambda: sum(map(is_worker, {*descendants(first)} - {killed})) == 2)
        assert time.monotonic() - since < 30  # it would wait for 60 s otherwise


@pytest.mark.parametrize(
    ("workers", "asked"), [(2, (signal.SIGINT,) * 3), (1, (signal.SIGINT,) * 3), (2, (signal.SIGTERM,))]
)
def test_they_fly_one_session_and_end_quietly_when_all_are_told_while_a_job_process_starts(
    tmp_path: Path, workers: int, asked: tuple[signal.Signals, ...]
) -> None:
    with serving(tmp_path / "data", WORKERS=str(workers)) as server, ThreadPoolExecutor(1) as pool:
        assert sorted(concurrent_steps(server.client)) == list(range(1, 41))
        job = pool.submit(httpx.get, server.url + "/maps/easy/7", timeout=60)
        eventually(lambda: any(map(is_importing, descendants(server.process.pid))))
        for number in asked:
            # As a terminal does: first the server, then all others.
            for process in (server.process.pid, *descendants(server.process.pid)):
                with suppress(ProcessLookupError):
                    os.kill(process, number)
        assert server.process.wait(timeout=60) == 0
        job.exception()
        assert "Traceback" not in server.log.read_text()


def descendants(process: int) -> list[int]:
    """Return the processes that a process and its descendants have started."""
    found: list[int] = []
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):
            for child in map(int, children.read_text().split()):
                found += [child, *descendants(child)]
    return found


def is_worker(process: int) -> bool:
    """Return whether a process is a server process that the first one has started."""
    with suppress(FileNotFoundError, ProcessLookupError):
        return "spawn_main" in Path(f"/proc/{process}/cmdline").read_text()
    return False


def is_importing(process: int) -> bool:
    """Return whether a process is the one that forks job processes, and has imported the first of its packages."""
    with suppress(FileNotFoundError, ProcessLookupError):
        folder = Path(f"/proc/{process}")
        return "forkserver" in (folder / "cmdline").read_text() and "pydantic_core" in (folder / "maps").read_text()
    return False


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


def is_running(process: int) -> bool:
    """Return whether a process has not ended, also if nobody waits for it."""
    with suppress(FileNotFoundError, ProcessLookupError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False
