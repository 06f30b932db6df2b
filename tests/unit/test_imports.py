"""What importing the package costs and what it needs, each seen from a fresh process."""

import json
import subprocess
import sys

import pytest

HEAVY = ("numba", "torch", "openenv", "fastapi")

MEASURE = """
import json, sys, time
before = time.process_time()
import {module}
print(json.dumps([time.process_time() - before, sorted(sys.modules)]))
"""

NUMPY_ALONE = """
import importlib, os, pkgutil, sys

class NumpyAlone:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in ("numpy", "drone_env"):
            raise ModuleNotFoundError("not to be needed: " + name, name=name)

import numpy
sys.meta_path.insert(0, NumpyAlone())
import drone_env.core
for module in pkgutil.iter_modules(drone_env.core.__path__):
    if module.name not in ("compiled", "batch"):
        importlib.import_module("drone_env.core." + module.name)
"""


def run_python(code: str) -> str:
    """What a fresh interpreter prints; its message becomes the test's if it fails."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def imported(module: str) -> tuple[float, list[str]]:
    """CPU seconds that the import takes, and all modules that are loaded then."""
    seconds, modules = json.loads(run_python(MEASURE.format(module=module)))
    return seconds, modules


def test_importing_the_package_takes_less_than_03_seconds_of_cpu() -> None:
    # The best of three: a busy machine can only add to it.
    assert min(imported("drone_env")[0] for _ in range(3)) < 0.3


@pytest.mark.parametrize("module", ["drone_env", "drone_env.core.state_manager"])
def test_importing_loads_nothing_heavy(module: str) -> None:
    loaded = imported(module)[1]
    assert module in loaded
    assert [name for name in HEAVY if name in loaded] == []


def test_the_core_needs_nothing_but_numpy() -> None:
    run_python(NUMPY_ALONE)
