"""The logic of `validate-submission.sh`: a real server or a failing one, and scripts in place of docker and openenv."""

import re
import subprocess
import threading
from collections.abc import Generator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.api.serving import Server
from tests.tools import missing_tool, reserved_port

from .commands import ROOT, Commands, linter

SCRIPT = str(ROOT / "validate-submission.sh")
NEEDED = ("cat", "curl", "find", "head", "mktemp", "rm", "sed", "tail", "timeout", "tr")
BANNER = """
========================================
  All 3/3 checks passed!
  Your submission is ready to submit.
========================================
"""
GONE = "http://127.0.0.1:{}"


@contextmanager
def answering(status: int) -> Generator[str, None, None]:
    """The address of a server that answers `POST /reset` with a status."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            right = (self.path, body, self.headers["Content-Type"]) == ("/reset", b"{}", "application/json")
            self.send_response(status if right else 400)
            self.end_headers()
            self.wfile.write(b"this is\x00the answer")

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def commands(tmp_path: Path) -> Commands:
    """Docker and openenv that do all they are asked to."""
    made = Commands(tmp_path / "bin", *NEEDED)
    made.add("docker", 'echo "docker $*"')
    made.add("openenv", 'echo "openenv $* in $PWD"')
    return made


@pytest.fixture
def space() -> Generator[str, None, None]:
    with answering(200) as url:
        yield url


@pytest.mark.feature("P3")
def test_all_three_pass_with_the_real_server(commands: Commands, server: Server) -> None:
    commands.add("docker", 'echo "$*" >> "$HOME/docker.log"')
    commands.add("openenv", 'echo "$* $PWD" >> "$HOME/openenv.log"')
    done = commands.run(SCRIPT, f"{server.url}/", str(ROOT))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(BANNER)
    assert done.stdout.count("PASSED: ") == 3
    assert (commands.folder / "docker.log").read_text().splitlines()[-1] == f"build --file {ROOT}/Dockerfile {ROOT}"
    assert (commands.folder / "openenv.log").read_text() == f"validate {ROOT}\n"


def failure(done: "subprocess.CompletedProcess[str]", passed: int = 2) -> str:
    """The output of a run that failed, as it must."""
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"  {passed}/3 checks passed." in done.stdout
    assert "3/3 checks passed!" not in done.stdout
    return done.stdout


@pytest.mark.parametrize(
    ("status", "hint"),
    [(404, "https://USER-NAME.hf.space, not the page"), (503, "building, asleep")],
)
def test_a_space_that_refuses_fails_the_first_check(commands: Commands, status: int, hint: str) -> None:
    with answering(status) as url:
        shown = failure(commands.run(SCRIPT, url))
    assert f"FAILED: it answers {status}: this isthe answer" in shown
    assert hint in shown


INFO = '[ "$1" = info ] && exit 0; '
FAILURES = {
    "no docker": ("docker", None, {}, "docker is not installed\n  Hint: https://docs.docker.com"),
    "no daemon": ("docker", 'echo "no daemon" >&2; exit 1', {}, "does not work: no daemon"),
    "failed build": ("docker", f'{INFO}echo "no such package" >&2; exit 7', {},
                     "  | no such package\n  FAILED: the build ended with status 7"),
    "slow build": ("docker", f"{INFO}sleep 30", {"BUILD_TIMEOUT": "1"}, "the build takes longer than 1 s"),
    "openenv fails": ("openenv", 'echo "FAIL static.manifest"; exit 1', {},
                      "  | FAIL static.manifest\n  FAILED: openenv validate"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAILURES)
def test_one_check_that_fails_leaves_the_others_alone(space: str, commands: Commands, case: str) -> None:
    command, script, variables, said = FAILURES[case]
    if script is None:
        (commands.folder / command).unlink()
    else:
        commands.add(command, script)
    assert said in failure(commands.run(SCRIPT, space, **variables))


def test_all_may_fail(commands: Commands, tmp_path: Path) -> None:
    (commands.folder / "openenv").unlink()
    shown = failure(commands.run(SCRIPT, GONE.format(reserved_port()), str(tmp_path)), passed=0)
    assert "FAILED: no answer: curl:" in shown
    assert f"FAILED: there is no Dockerfile in {tmp_path}" in shown


def test_podman_builds_if_it_is_chosen(space: str, commands: Commands) -> None:
    (commands.folder / "docker").rename(commands.folder / "podman")
    done = commands.run(SCRIPT, space, BUILDER="podman")
    assert done.returncode == 0, done.stdout
    assert "podman build ." in done.stdout


def test_what_openenv_refuses_without_a_name_is_named(space: str, commands: Commands, tmp_path: Path) -> None:
    clone = tmp_path / "a clone"
    (clone / ".venv" / "bin").mkdir(parents=True)
    (clone / ".venv" / "bin" / "python").symlink_to("/usr/bin/python3")
    (clone / "Dockerfile").touch()
    link = clone / "a link"
    link.symlink_to("Dockerfile")
    commands.add("openenv", "exit 1")
    assert f"or put files in their place:\n  | {link}\n  Hint: (cd" in failure(commands.run(SCRIPT, space, str(clone)))
    openenv = (commands.folder / "openenv").rename(clone / ".venv" / "bin" / "openenv")
    assert f"run '. {clone}/.venv/bin/activate', and this" in failure(commands.run(SCRIPT, space, str(clone)))
    openenv.unlink()
    assert "pip install 'openenv>=0.10'" in failure(commands.run(SCRIPT, space, str(clone)))


@pytest.mark.feature("P3")
def test_the_guide_has_the_same_steps_for_powershell() -> None:
    guide = (ROOT / "docs" / "deployment.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```powershell\n(.*?)```", guide, re.DOTALL)
    assert any("Invoke-RestMethod -Method Post" in block and "openenv validate" in block for block in blocks)


@pytest.mark.parametrize(
    ("arguments", "variables", "said"),
    [
        (["user-name.hf.space"], {}, "must start with https:// or http://, got user-name.hf.space"),
        (["https://x.hf.space", "/no/such/folder"], {}, "there is no folder /no/such/folder"),
        (["https://x.hf.space"], {"BUILDER": "make"}, "BUILDER must be docker or podman, got make"),
    ],
)
def test_a_wrong_call_is_told(commands: Commands, arguments: list[str], variables: dict[str, str], said: str) -> None:
    done = commands.run(SCRIPT, *arguments, **variables)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert "Usage:" in done.stderr


def test_the_script_is_clean() -> None:
    shellcheck = linter("shellcheck") or missing_tool("shellcheck")
    done = subprocess.run([shellcheck, SCRIPT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
