"""Run the README's commands in order, as on a fresh machine, and print the time of each.

    python3 tests/stranger.py                     in a clone of the last commit, in a folder of its own
    python3 tests/stranger.py --keep DIR          the same in DIR, which is kept
    python3 tests/stranger.py --beside COMMAND    the same, with COMMAND beside all that is typed after `make test`

Needs what the README says is needed, and Git. Commands that serve go on in the background while the next ones are
typed. The token to fill in is one for the scripted endpoint of the tests. Exit status 0 if every command ended with 0.
"""

import argparse
import contextlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Generator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.tools import ROOT, eventually, is_taken, reserved_port

SERVES = ("drone-env serve", "make serve")
TESTS = "make test"
FILL_IN = "cp .env.example .env"
PATIENCE = 120.0
"""Seconds within which what was started in the background must end."""


def commands(readme: str) -> list[str]:
    """The commands of all `bash` blocks, in order."""
    lines = "\n".join(re.findall(r"^```bash\n(.*?)^```", readme, re.DOTALL | re.MULTILINE))
    typed = lines.replace("\\\n", " ").splitlines()
    return [line for line in typed if shlex.split(line, comments=True)]


@contextlib.contextmanager
def background(command: list[str], port: int, cwd: Path, env: dict[str, str]) -> Generator[None, None, None]:
    """A command that serves, until the end of the `with`.

    Raises:
        AssertionError: if it ends, or does not listen in time.
    """
    process = subprocess.Popen(command, cwd=cwd, env=env, start_new_session=True)
    try:
        eventually(lambda: process.poll() is not None or is_taken(port), lambda: f"nothing listens on port {port}")
        assert process.poll() is None, f"{command} has ended"
        yield
    finally:
        for sent in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.killpg(process.pid, sent)
                process.wait(PATIENCE)


def scripted_endpoint(clone: Path, stack: contextlib.ExitStack, environment: dict[str, str]) -> str:
    """A language model that flies well, whatever the prompt; its base URL."""
    port = reserved_port()
    python = str(clone / ".venv/bin/python")
    command = [python, "tests/llm/scripted_server.py", str(port)]
    stack.enter_context(background(command, port, cwd=clone, env=environment))
    body = json.dumps({"pilot": "able"})
    urllib.request.urlopen(f"http://127.0.0.1:{port}/stranger/script", body.encode()).close()
    return f"http://127.0.0.1:{port}/stranger/v1"


def walk(clone: Path, beside: str | None) -> list[tuple[str, float, int]]:
    """Type every command, and one more beside those after the tests; what it was, its seconds and its exit status."""
    environment = {**os.environ, "PATH": f"{clone / '.venv/bin'}{os.pathsep}{os.environ['PATH']}"}
    for name in ("VIRTUAL_ENV", "PYTHONDONTWRITEBYTECODE"):
        environment.pop(name, None)
    walked: list[tuple[str, float, int]] = []
    other: subprocess.Popen[bytes] | None = None
    began = 0.0
    with contextlib.ExitStack() as stack:
        for command in commands((clone / "README.md").read_text(encoding="utf-8")):
            print(f"\n$ {command}", flush=True)
            start, status = time.perf_counter(), 0
            words = shlex.split(command, comments=True)
            try:
                if command.startswith(SERVES):
                    stack.enter_context(background(words, 8000, cwd=clone, env=environment))
                else:
                    done = subprocess.run(
                        ["bash", "-c", command], cwd=clone, env=environment, stdin=subprocess.DEVNULL, check=False
                    )
                    status = done.returncode
                if command.startswith(FILL_IN):
                    url = scripted_endpoint(clone, stack, environment)
                    with (clone / ".env").open("a") as file:
                        file.write(f"\nAPI_BASE_URL={url}\nOPENAI_API_KEY=stranger\n")
            except (OSError, AssertionError) as error:
                print(error, file=sys.stderr)
                status = 1
            walked.append((command, time.perf_counter() - start, status))
            if beside and command.startswith(TESTS):
                began = time.perf_counter()
                other = subprocess.Popen(["bash", "-c", beside], cwd=clone, env=environment, stdin=subprocess.DEVNULL)
    if beside and other:
        status = other.wait()
        walked.append((f"{beside}    # beside what is typed after {TESTS}", time.perf_counter() - began, status))
    return walked


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="clone into this new folder and keep it")
    parser.add_argument("--beside", metavar="COMMAND", help="run this beside the commands after `make test`")
    arguments = parser.parse_args()
    keep: Path | None = arguments.keep
    with tempfile.TemporaryDirectory() as folder:
        clone = (keep or Path(folder) / "drone-env").resolve()
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        walked = walk(clone, arguments.beside)
    print(f"\n{'seconds':>9}  {'exit':>4}  command")
    for command, seconds, status in walked:
        print(f"{seconds:9.1f}  {status:4}  {command}")
    failed = sum(status != 0 for _, _, status in walked)
    print(f"{len(walked)} commands of the README, {failed} failed, {sum(s for _, s, _ in walked):.0f} s")
    return 1 if failed or not walked else 0


if __name__ == "__main__":
    sys.exit(main())
