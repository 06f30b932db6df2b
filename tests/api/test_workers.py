"""Several worker processes on one data folder."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from drone_env.client import DroneEnvClient
from drone_env.core.state_manager import Episode
from drone_env.planning.optimal import solve
from tests.api.serving import Server, serving


def test_several_workers_serve_one_session_and_end_when_the_first_process_is_asked_to(tmp_path: Path) -> None:
    with serving(tmp_path / "data", ("drone_env/server/app.py", "--workers", "2")) as server:
        steps_over_many_connections_follow_each_other(server)
        concurrent_steps_are_flown_one_after_another(server)
        server.process.terminate()
        assert server.process.wait(timeout=60) == 0
        assert "Traceback" not in server.log.read_text()


def steps_over_many_connections_follow_each_other(workers: Server) -> None:
    expected = Episode("hard")
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


@pytest.mark.long
def test_a_worker_that_is_slow_for_a_while_is_not_replaced(tmp_path: Path) -> None:
    with serving(tmp_path / "data", WORKERS="2") as server:
        children = Path(f"/proc/{server.process.pid}/task/{server.process.pid}/children")
        if not children.exists():
            pytest.skip("this system does not tell the children of a process")
        before = children.read_text().split()
        try:
            for child in before:
                os.kill(int(child), signal.SIGSTOP)
            # More than the 5 s after which uvicorn would replace them unasked.
            time.sleep(12)
            after = children.read_text().split()
        finally:
            for child in before:
                os.kill(int(child), signal.SIGCONT)
        assert after == before
