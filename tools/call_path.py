"""Count how many files of `drone_env` three common operations visit, and how often the visit moves to another file.

Run: python tools/call_path.py [http] [evaluation] [flight]

Each operation runs once to warm up, then once while `sys.setprofile` and `threading.setprofile` report every Python
call of every thread. Only calls of functions whose code is in `drone_env/` count; the start or resumption of a
generator or coroutine is a call too. Returns, generated code such as the `__init__` of a dataclass, and compiled
kernels do not count.

- files: the files that contain a called function.
- changes: the consecutive calls, in the order of time over all threads, that are in different files.

The operations: one `POST /step`, the ninth of an HTTP session; `drone-env evaluate` of one agent over ten maps of one
task, whose optima the warm-up has cached; and `drone-env infer` over one map of 60 steps against a scripted endpoint,
from the command line to the report, with the lines of each step on standard output.
"""

import contextlib
import io
import itertools
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Generator
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[1]
PACKAGE = f"{ROOT / 'drone_env'}{os.sep}"
visits = list[str]()
"""The file of each counted call since the last `clear`."""


def profile(frame: FrameType, event: str, _: object) -> None:
    """Note the file of a call."""
    if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
        visits.append(frame.f_code.co_filename)


@contextlib.contextmanager
def http() -> Generator[Callable[[], object], None, None]:
    """One step over HTTP."""
    from starlette.testclient import TestClient

    from drone_env.server.app import create_app
    from drone_env.server.settings import Settings

    with TestClient(create_app(Settings(data=Path("data")))) as client:
        client.post("/reset", json={"seed": 14}).raise_for_status()
        for _ in range(7):
            client.post("/step", json={"direction": "WAIT"}).raise_for_status()
        yield lambda: client.post("/step", json={"direction": "WAIT"}).raise_for_status()


@contextlib.contextmanager
def evaluation() -> Generator[Callable[[], object], None, None]:
    """One evaluation."""
    from drone_env.cli import main

    yield lambda: main(["evaluate", "--task", "easy", "--agents", "greedy", "--episodes", "10"])


@contextlib.contextmanager
def flight() -> Generator[Callable[[], object], None, None]:
    """One flight of a language model."""
    from drone_env.cli import main
    from tests.llm import scripted_server as scripted

    scripted.scripts["call_path"] = {"pilot": "WAIT", "log": [], "numbers": itertools.count()}
    with scripted.Server(("127.0.0.1", 0), scripted.Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        where = ["--base-url", f"http://127.0.0.1:{server.server_port}/call_path/v1", "--model", "scripted"]
        yield lambda: main(["infer", *where, "--task", "easy", "--seeds", "14:15", "--out", tempfile.mkdtemp(dir=".")])
        server.shutdown()


def main() -> None:
    """Print the table."""
    targets = {http: "10 / 20", evaluation: "18 / 60", flight: "30 / 1,500"}
    sys.path.insert(0, str(ROOT))
    os.environ["OPENAI_API_KEY"] = "none"
    threading.setprofile(profile)
    print(f"{'case':<12}{'files':>6}{'changes':>9}  target")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for case in [c for c in targets if c.__name__ in sys.argv[1:]] or targets:
            with case() as operation, contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(sys.stdout):
                operation()
                visits.clear()
                sys.setprofile(profile)
                operation()
                sys.setprofile(None)
                seen = visits.copy()
            changes = sum(a != b for a, b in itertools.pairwise(seen))
            print(f"{case.__name__:<12}{len(set(seen)):>6}{changes:>9,}  {targets[case]}")


if __name__ == "__main__":
    main()
