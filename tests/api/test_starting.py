"""The server process: start, errors, end; the Python client."""

import re
import signal
import socket
import sys
from pathlib import Path

import httpx
import pytest

from drone_env.server import app
from tests.api.serving import Server, serving
from tests.tools import PATIENCE, find_tool, ran, reserved_port
from tests.unit.stores import open_sessions

EXAMPLE = """
from drone_env.client import DroneEnvClient

with DroneEnvClient("http://localhost:8000") as client:
    # Check server health
    print(client.health())

    # Run a random episode for smoke-testing
    result = client.run_random_episode("easy_delivery", verbose=True)
    print(f"Score: {result['score']:.4f}")

    # Manual episode loop
    obs = client.reset("hard_delivery")
    while not obs["done"]:
        obs = client.step("RIGHT")   # or UP / DOWN / LEFT / WAIT

    analytics = client.analyse("hard_delivery")
    print(analytics)
"""
"""As the first description of the project had it."""
RUN_UV = """
import os, sys
uv, environment, run, *rest = sys.argv[1:]
os.environ["UV_PROJECT_ENVIRONMENT"] = environment
os.execv(uv, [uv, run, "--no-sync", *rest])
"""


@pytest.mark.feature("H13")
@pytest.mark.parametrize(
    ("command", "asked", "status"),
    [
        pytest.param("uv run server", signal.SIGTERM, 128 + signal.SIGTERM, marks=pytest.mark.long),
        pytest.param(
            "python -m uvicorn server.app:app --host 0.0.0.0", signal.SIGTERM, -signal.SIGTERM, marks=pytest.mark.long
        ),
        ("python drone_env/server/app.py --host 0.0.0.0", signal.SIGINT, 0),
    ],
)
def test_each_way_to_start_it_starts_it_and_it_ends_when_it_is_asked(
    tmp_path: Path, command: str, asked: signal.Signals, status: int
) -> None:
    first, *rest = command.split()
    if first == "uv":
        # In the environment of the tests, as it is: what `uv run` would install is there.
        rest = ["-c", RUN_UV, find_tool("uv"), sys.prefix, *rest]
    with serving(tmp_path / "data", tuple(rest)) as server:
        with httpx.Client(base_url=server.url, timeout=PATIENCE) as http:
            assert http.get("/health").json()["status"] == "healthy"
            assert http.post("/reset", json={"seed": 14}).status_code == 200
            http.cookies.clear()
            assert http.get("/state").status_code == 200, "callers who name no session"
        server.process.send_signal(asked)
        assert server.process.wait(PATIENCE) == status
        assert "Traceback" not in server.log.read_text()
    assert open_sessions(tmp_path / "data") == 1


def test_an_error_is_one_line_and_creates_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # All that the command itself sets, so that it is put back.
    for name, value in {"DATA": tmp_path / "data", "PORT": reserved_port(), "HOST": "", "WORKERS": ""}.items():
        monkeypatch.setenv(f"DRONE_ENV_{name}", str(value))

    def error_of(*arguments: str) -> str:
        with pytest.raises(SystemExit) as ended:
            app.main(arguments)
        message = str(ended.value.code)
        assert message.startswith("server: ")
        assert "\n" not in message
        return message.removeprefix("server: ")

    assert __file__ in error_of("--data", __file__, "--workers", "2")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        said = error_of("--port", str(taken.getsockname()[1]), "--workers", "2")
        assert said.startswith("cannot listen on 127.0.0.1: Address already in use")
    monkeypatch.setenv("DRONE_ENV_IDLE_SECONDS", "-1")
    assert error_of().startswith("DRONE_ENV_IDLE_SECONDS: ")
    assert not (tmp_path / "data").exists()


@pytest.mark.feature("H14")
def test_the_first_example_of_the_python_client_runs_as_printed(
    server: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(EXAMPLE.replace("http://localhost:8000", server.url), "the example", "exec"), {})
    health, *steps, score, analytics = capsys.readouterr().out.splitlines()
    assert "'status': 'healthy'" in health
    assert steps
    assert all(line.startswith(f"step {number}: ") for number, line in enumerate(steps, start=1))
    assert re.fullmatch(r"Score: 0\.\d{4}", score)
    assert "'task': 'hard_delivery'" in analytics


@pytest.mark.feature("H14")
def test_the_client_as_a_command_flies_a_smoke_mission(server: Server) -> None:
    run = ran(sys.executable, "-m", "drone_env.client", server.url)
    assert (run.returncode, run.stderr) == (0, "")
    flown = re.search(r"^score: 0\.9\d{3} in (\d+) steps; the server works$", run.stdout, re.MULTILINE)
    assert flown is not None
    assert run.stdout.count("step ") == int(flown[1]) <= 18
    assert f"step {flown[1]}: " in run.stdout.partition("delivered 1/1")[0]
