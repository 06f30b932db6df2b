"""The commands of the project's first description work unchanged.

Each way to start the server and the Python client are in tests/api/test_starting.py, `inference.py` in tests/llm, what
is typed to build and to hand in in tests/container.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.api.serving import serving
from tests.package.installed import copy_tracked
from tests.tools import ROOT, find_tool, missing_tool, ran

TRAIN = "train.py --task easy_delivery --episodes 500"


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.feature("L4")
def test_the_first_training_reads_as_one_that_learns(tmp_path: Path) -> None:
    pytest.importorskip("torch")

    def train() -> str:
        done = ran(sys.executable, *shlex.split(str(ROOT / TRAIN)), cwd=tmp_path)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
        return done.stdout + done.stderr

    said = train()
    logged = (tmp_path / "data" / "train.log").read_text()
    assert "nan" not in logged + said
    lines = [dict(part.split("=") for part in line.split()) for line in logged.splitlines()]
    assert (len(lines), lines[-1]["episode"]) == (25, "500")
    for figure in ("score", "success", "reward"):
        first, last = (sum(float(line[figure]) for line in part) / 8 for part in (lines[:8], lines[-8:]))
        assert last > first + 0.15
    assert all(float(line["success"]) > 0.9 for line in lines[-8:])
    validated = [float(line["validation"]) for line in lines if line["validation"] != "-"]
    assert validated[0] < 0.8
    assert validated[-1] > 0.9
    assert "500" in train()
    with serving(tmp_path / "data") as server:
        assert server.client.get("/logs").json()["lines"] == logged.splitlines()[-50:]
        server.client.post("/reset").raise_for_status()
        assert server.client.post("/predict").json()["model"]


@pytest.mark.campaign
@pytest.mark.timeout(1800)
def test_uv_sync_brings_all_but_pytorch(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    copy_tracked(clone)
    ours = ("VIRTUAL_ENV", "PYTHONPATH", "UV_PROJECT_ENVIRONMENT", "DRONE_ENV_REQUIRE_TOOLS", "PYTEST_ADDOPTS")
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    path = f"{clone / '.venv' / 'bin'}{os.pathsep}{Path(find_tool('uv')).parent}{os.pathsep}{os.environ['PATH']}"
    environment |= {"PATH": path, "UV_PYTHON": sys.executable}  # not another Python than these tests run on

    def typed(line: str) -> tuple[int, str]:
        done = subprocess.run(["bash", "-c", line], cwd=clone, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    status, said = typed("uv sync")
    if "Failed to fetch" in said:
        missing_tool("an index of packages")
    assert status == 0, said
    for line, ends, tells in (
        (f"python {TRAIN}", 2, "run: uv sync --extra train\n"),
        ("python check_graders.py", 0, "3 valid graders found."),
        ("uv run server --help", 0, "--port"),
        ("uv run pytest tests/test_env.py -v", 0, "missing: torch;"),
        ("uv run pytest tests/test_api.py -v", 0, "passed"),
        ("uv run pytest tests/ -v --collect-only --quiet", 0, "tests collected"),
    ):
        status, said = typed(line)
        assert (status, tells in said) == (ends, True), said
