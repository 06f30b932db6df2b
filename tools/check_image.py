"""Build the container and prove that it works: python tools/check_image.py --builder podman.

Each line that it prints was measured with the image that it has just built; it ends at the first thing that is wrong.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import httpx
from openenv.cli._validation import validate_running_environment

sys.path.insert(0, str(Path(__file__).parents[1]))

from drone_env.client import DroneDeliveryClient, DroneEnvClient
from drone_env.models import DroneAction
from drone_env.planning.optimal import solve
from tools.build_image import LOG, ROOT, build

START_SECONDS = 60
STOP_SECONDS = 10
HARDENED = ("--read-only", "--tmpfs", "/tmp", "--cap-drop", "ALL", "--security-opt", "no-new-privileges")
KEPT = ("--env", "DRONE_ENV_DATA=/data", "--env", "DRONE_ENV_CACHE=/data/cache")
# How `openenv validate` starts an image.
AS_VALIDATED = (*HARDENED, "--user", "65532:65532", "--memory", "1024m", "--cpus", "1", "--pids-limit", "256")
MUST_BE_ABSENT = ("torch", "openenv", "gradio", "pandas", "pytest")

WAITS = """
import http.server, json, os, subprocess, sys, threading

class Model(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        self.rfile.read(int(self.headers["Content-Length"]))
        body = json.dumps({"choices": [{"message": {"content": "WAIT"}, "finish_reason": "stop"}]}).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass

server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Model)
threading.Thread(target=server.serve_forever, daemon=True).start()
address = {"API_BASE_URL": f"http://127.0.0.1:{server.server_port}/v1", "MODEL_NAME": "waits"}
sys.exit(subprocess.call([sys.executable, "inference.py"], env={**os.environ, **address}))
"""
"""Lets a model that always waits, in the container itself, fly by `inference.py`."""


class WrongError(Exception):
    """Something that does not hold of the image."""


class Image:
    """An image and the program that runs it.

    Args:
        engine: `docker` or `podman`.
        tag: The image's name.
    """

    def __init__(self, engine: str, tag: str) -> None:
        self.engine = engine
        self.tag = tag

    def call(self, *arguments: str) -> str:
        """What the engine prints.

        Raises:
            WrongError: if it fails.
        """
        done = self.tried(*arguments)
        if done.returncode != 0:
            raise WrongError(f"{self.engine} {' '.join(arguments)}: {done.stdout}{done.stderr}")
        return done.stdout.strip()

    def tried(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """The engine, run to its end."""
        return subprocess.run([self.engine, *arguments], capture_output=True, text=True, check=False)

    def described(self) -> dict[str, Any]:
        """The metadata of the image."""
        return cast("list[dict[str, Any]]", json.loads(self.call("image", "inspect", self.tag)))[0]

    def health_command(self) -> list[str]:
        """The image's own HEALTHCHECK."""
        described = self.described()
        # Podman shows it beside the configuration, Docker in it.
        check = described.get("Healthcheck") or described["Config"].get("Healthcheck")
        if not check:
            raise WrongError("the image has no HEALTHCHECK")
        kind, *command = cast("list[str]", check["Test"])
        if kind != "CMD":
            raise WrongError(f"the HEALTHCHECK goes through a shell: {kind}")
        return command

    @contextmanager
    def running(self, *options: str) -> Generator["Container", None, None]:
        """A container of the image with its own command, removed at the end."""
        name = self.call("run", "--detach", "--publish", "127.0.0.1::8000", *options, self.tag)
        try:
            yield Container(self, name)
        finally:
            self.tried("rm", "--force", name)


class Container:
    """A running container.

    Args:
        image: What it runs.
        name: Its id.
    """

    def __init__(self, image: Image, name: str) -> None:
        self.image = image
        self.name = name

    @property
    def url(self) -> str:
        """URL of its server; it changes with a restart."""
        return f"http://{self.image.call('port', self.name, '8000').splitlines()[0]}"

    def inside(self, *command: str) -> "subprocess.CompletedProcess[str]":
        """A command in it, run to its end."""
        return self.image.tried("exec", self.name, *command)

    def wait(self) -> float:
        """Seconds until its server answers."""
        started = time.monotonic()
        while time.monotonic() - started < START_SECONDS:
            with suppress(httpx.HTTPError):
                if httpx.get(f"{self.url}/health", timeout=5).json()["status"] == "healthy":
                    return time.monotonic() - started
            time.sleep(0.05)
        raise WrongError(f"no answer within {START_SECONDS} s: {self.image.tried('logs', self.name).stderr}")


def require(holds: bool, text: str) -> None:
    """Say that something holds.

    Raises:
        WrongError: if it does not.
    """
    if not holds:
        raise WrongError(text)
    print(f"ok: {text}", flush=True)


def fly(client: DroneEnvClient, task: str, seed: int) -> float:
    """Seconds of the best flight over a map; its score must be the map's optimum."""
    best = solve(task, seed)
    started = time.monotonic()
    observation = client.reset(task, seed=seed)
    for action in best.actions:
        observation = client.step(action.name)
    seconds = time.monotonic() - started
    require(
        observation["score"] == best.score, f"{task} map {seed} is flown over HTTP to its optimum, {best.score:.3f}"
    )
    return seconds


def check_contents(image: Image) -> None:
    """The layers of the image."""
    described = image.described()
    print(f"size: {described['Size'] / 1e6:.0f} MB", flush=True)
    user = str(described["Config"]["User"])
    require(user.partition(":")[0] not in ("", "0", "root"), f"its user is {user}")
    found = f"import importlib.util as u; print([n for n in {MUST_BE_ABSENT!r} if u.find_spec(n)])"
    listed = image.call("run", "--rm", image.tag, "python", "-c", found)
    require(listed == "[]", f"it holds none of {', '.join(MUST_BE_ABSENT)} (found: {listed})")
    ended = image.tried("run", "--rm", image.tag, *image.health_command())
    require(ended.returncode != 0, "the HEALTHCHECK fails where no server runs")


def check_service(image: Image, volume: str) -> None:
    """A server under a read-only root, with a volume."""
    with image.running(*HARDENED, *KEPT, "--volume", f"{volume}:/data") as server:
        print(f"seconds to the first answer: {server.wait():.1f}", flush=True)
        require(server.inside("touch", "/app/new").returncode != 0, "its root is read-only")
        require(server.inside("id", "-u").stdout.strip() != "0", "its process is not root")
        require(server.inside(*image.health_command()).returncode == 0, "the HEALTHCHECK passes")
        with DroneEnvClient(server.url) as client:
            print(f"seconds of the first flight: {fly(client, 'hard_delivery', 7):.2f}", flush=True)
        flown = cast(Any, DroneDeliveryClient(server.url).sync())
        with flown as env:
            result = env.reset(task_name="easy", seed=7)
            for action in solve("easy", 7).actions:
                result = env.step(DroneAction.model_validate({"direction": action.name}))
        require(result.done, "OpenEnv's client flies a mission over the WebSocket")
        report = validate_running_environment(server.url)
        passed, total = report["summary"]["passed_count"], report["summary"]["total_count"]
        require(bool(report["passed"]), f"openenv validate --url passes {passed}/{total}")
        check_model(server)
        session, steps = check_restart(image, server)
        started = time.monotonic()
        image.call("stop", "--time", str(STOP_SECONDS), server.name)
        seconds = time.monotonic() - started
        status = image.call("container", "inspect", "--format", "{{.State.ExitCode}}", server.name)
        require(
            seconds < STOP_SECONDS and status in ("0", "143"), f"SIGTERM ends it in {seconds:.1f} s, status {status}"
        )

    with image.running(*HARDENED, *KEPT, "--volume", f"{volume}:/data") as successor:
        successor.wait()
        require(steps_of(successor, session) == steps, "a session goes on in a new container with the same volume")


def check_model(server: Container) -> None:
    """`inference.py` beside the server, which shows the flight."""
    done = server.inside("python", "-c", WAITS)
    if done.returncode != 0:
        raise WrongError(f"inference.py in it ends with {done.returncode}: {done.stderr}")
    lines = [line.partition(" ")[0] for line in done.stdout.splitlines()]
    require(lines == ["[START]", *["[STEP]"] * 60, "[END]"], "inference.py lets a model fly in it")
    flown = httpx.get(f"{server.url}/memory_logs").json()["episodes"]
    require([episode["agent"] for episode in flown][:1] == ["waits"], "the server shows that flight")


def check_restart(image: Image, server: Container) -> tuple[str, int]:
    """A session goes on after a restart; the session, and its steps."""
    client = DroneEnvClient(server.url)
    client.reset("hard_delivery", seed=7)
    steps = int(client.step("RIGHT")["step_count"])
    session = str(client.session_id)
    client.close(keep_session=True)
    image.call("restart", "--time", str(STOP_SECONDS), server.name)
    server.wait()
    require(steps_of(server, session) == steps, "a session goes on where it was after a restart")
    return session, steps


def steps_of(server: Container, session: str) -> int:
    """Steps that a session has flown."""
    client = DroneEnvClient(server.url)
    client.session_id = session
    steps = int(client.state()["step_count"])
    client.close(keep_session=True)
    return steps


def check_elsewhere(image: Image) -> None:
    """A server as OpenEnv's validator starts it, a foreign user with nothing to write to but /tmp; and as a Space."""
    with image.running(*AS_VALIDATED) as server:
        seconds = server.wait()
        require(
            seconds < 30, f"it answers a foreign user under a read-only root without a volume, after {seconds:.1f} s"
        )
        with DroneEnvClient(server.url) as client:
            fly(client, "easy_delivery", 7)
    with image.running("--env", "FORWARDED_ALLOW_IPS=*") as server:
        server.wait()
        answer = httpx.post(f"{server.url}/reset", json={}, headers={"X-Forwarded-Proto": "https"})
        cookie = answer.headers["set-cookie"].lower()
        require(
            "secure" in cookie and "samesite=none" in cookie, "as a Space it marks its cookie for frames over HTTPS"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Build and check as the arguments say; 1 if something is wrong."""
    parser = argparse.ArgumentParser(
        description="Build the container and prove that it works.",
        epilog="Further options go to the builder's build command.",
        allow_abbrev=False,
    )
    parser.add_argument("--builder", choices=("docker", "podman"), default="docker", help="(%(default)s)")
    parser.add_argument("--tag", default="drone-env", help="name of the image (%(default)s)")
    parser.add_argument("--no-build", action="store_true", help="check the image that is there")
    given, options = parser.parse_known_args(arguments)
    image = Image(given.builder, given.tag)
    volume = f"drone-env-check-{time.time_ns()}"
    try:
        if not given.no_build:
            require(build(given.builder, given.tag, ROOT, LOG, options) == 0, "the image builds")
        check_contents(image)
        image.call("volume", "create", volume)
        check_service(image, volume)
        check_elsewhere(image)
    except (WrongError, httpx.HTTPError, OSError) as error:
        print(f"WRONG: {error}", file=sys.stderr)
        return 1
    finally:
        image.tried("volume", "rm", "--force", volume)
    print("All of it holds.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
