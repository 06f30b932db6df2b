"""The suite itself: nothing of the user's environment reaches a test, and only our own warnings are errors."""

import os
import re
import subprocess
import sys
from pathlib import Path

from tests.api.serving import ROOT

PROBE = """
import os
import warnings
from pathlib import Path

import pytest

from drone_env.files import data_folder
from drone_env.llm.settings import load_settings
from drone_env.server.settings import Settings

def test_environment():
    assert load_settings().hf_token is None
    assert load_settings().drone_task == "easy_delivery"
    assert Settings() == Settings.model_construct()
    assert not {"PYTHONDONTWRITEBYTECODE", "NO_COLOR", "COLUMNS"} & os.environ.keys()
    data_folder().mkdir()

@pytest.mark.parametrize("category", [RuntimeWarning, DeprecationWarning])
@pytest.mark.parametrize("module", ["drone_env.core", "drone_environment"])
def test_warning(module, category):
    warnings.warn_explicit("told", category, "file.py", 1, module)

def test_destructor():
    class Failing:
        def __del__(self):
            raise ValueError
    Failing()
"""
HOSTILE = {
    "DRONE_ENV_CAPACITY": "none",
    "DRONE_ENV_PLUGINS": "nonsense",
    "DRONE_ENV_TOKEN": "secret",
    "drone_task": "hard_delivery",
    "HF_TOKEN": "hf_of_the_user",
    "COLUMNS": "20",
    "NO_COLOR": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
}


def failures(tmp_path: Path, *options: str, **variables: str) -> list[str]:
    """The tests of the probe that fail, as parts of the tests run from a folder with a `.env`."""
    probe, here = tmp_path / "test_probe.py", tmp_path / "here"
    probe.write_text(PROBE)
    here.mkdir()
    (here / ".env").write_text("HF_TOKEN=hf_of_the_user\nDRONE_TASK=hard_delivery\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "tests.conftest", *options]
    command += ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), str(probe)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": "", **variables}
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=False)
    assert "failed" in done.stdout, done.stdout + done.stderr
    assert [file.name for file in here.iterdir()] == [".env"]
    return re.findall(r"^FAILED \S*test_probe\.py::(\S+)", done.stdout, re.MULTILINE)


def test_the_users_environment_is_neither_read_nor_written(tmp_path: Path) -> None:
    failed = failures(tmp_path, **HOSTILE, DRONE_ENV_DATA=str(tmp_path / "user"))
    assert not (tmp_path / "user").exists()
    # Deprecations come with new Pythons and dependencies.
    assert failed == ["test_warning[drone_env.core-RuntimeWarning]", "test_destructor"]


def test_all_warnings_can_be_errors(tmp_path: Path) -> None:
    assert len(failures(tmp_path, "-W", "error")) == 5
