"""Each extra contains the imports of its part of the package, and errors name the missing extra."""

import json
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from drone_env.toml_text import parse_toml
from tests.tools import LEFT_OUT, ROOT, find_tool, ran

PROJECT = parse_toml((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

NEEDS: Mapping[str, tuple[str, ...]] = {
    "drone_env": (),
    "drone_env.agents.hub": ("hub",),
    "drone_env.client": ("server",),
    "drone_env.cluster": ("cluster",),
    "drone_env.datasets": ("data",),
    "drone_env.llm": ("llm",),
    "drone_env.llm.inspect_task": ("inspect",),
    "drone_env.llm.local": ("trl",),
    "drone_env.llm.trl_environment": ("trl",),
    "drone_env.openenv_client": ("server",),
    "drone_env.rl": ("train",),
    "drone_env.server": ("server",),
}
"""The extras that a module may import, and its submodules without an own entry."""


NOT_INSTALLED = {("inspect",), ("trl",)}
"""Extras that are no part of the development tools."""


@cache
def distributions(*extras: str) -> frozenset[str]:
    """The names of what the package with extras installs on this machine, as uv.lock has it."""
    options = ["--frozen", "--offline", "--no-default-groups", "--no-emit-project", "--no-hashes"]
    exported = ran(find_tool("uv"), "export", *options, *(f"--extra={extra}" for extra in extras))
    assert exported.returncode == 0, exported.stderr
    pins = [Requirement(line) for line in exported.stdout.splitlines() if re.match(r"\w", line)]
    return frozenset(canonicalize_name(pin.name) for pin in pins if pin.marker is None or pin.marker.evaluate())


def brought(*extras: str) -> set[str]:
    """The top-level modules of these distributions."""
    found: set[str] = set()
    for name in distributions(*extras):
        found.add(name.replace("-", "_"))
        with suppress(PackageNotFoundError):
            found |= {file.parts[0].partition(".")[0] for file in files(name) or ()}
    return found


def needs(module: str) -> tuple[str, ...]:
    while module not in NEEDS:
        module = module.rpartition(".")[0]
    return NEEDS[module]


def modules() -> Iterator[str]:
    for file in sorted((ROOT / "drone_env").rglob("*.py")):
        yield ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


IMPORT = """
import importlib, json, sys
there, modules = json.loads(sys.argv[1])

class Bare:
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        return self.finder.find_spec(name, path, target) if name.partition(".")[0] in there or name[0] == "_" else None

sys.meta_path[:] = map(Bare, sys.meta_path)
for module in modules:
    try:
        importlib.import_module(module)
    except ImportError as error:
        print(f"{module}: {error}")
"""


def not_brought(extras: tuple[str, ...]) -> list[str]:
    """The modules that cannot be imported with these extras alone."""
    # The last two are in Ray.
    there = sorted({*brought(*extras), *sys.stdlib_module_names, "drone_env", "colorama", "psutil"})
    parts = [module for module in modules() if needs(module) == extras]
    done = ran(sys.executable, "-c", IMPORT, json.dumps([there, parts]))
    assert done.returncode == 0, done.stderr
    return [line for line in done.stdout.splitlines() if "needs Stable-Baselines3" not in line]  # of no extra


BARE = (
    IMPORT.partition("for module in modules")[0]
    + """
import contextlib, io, runpy
told = {}
for program in modules:
    sys.argv, before = program, set(sys.modules)
    error = io.StringIO()
    with contextlib.redirect_stderr(error):
        try:
            run = runpy.run_path if program[0].endswith(".py") else runpy.run_module
            run(program[0], run_name="__main__")
        except SystemExit as end:
            status = end.code
            if isinstance(status, str):
                print(status, file=sys.stderr)
        except BaseException as failure:
            status = repr(failure)
    told[" ".join(program)] = [str(status), error.getvalue()]
    for name in set(sys.modules) - before:
        if name.startswith("drone_env"):
            del sys.modules[name]
print(json.dumps(told))
"""
)
PROGRAMS: Mapping[str, str] = {
    "drone_env.cli infer": "llm",
    "drone_env.cli serve": "server",
    "drone_env.cli train": "train",
    "drone_env.cli dataset --task easy --maps 1 --out x": "data",
    "drone_env.cli city x.osm --out y.toml": "city",
    "drone_env.cli evaluate --ray local --task easy": "cluster",
    "drone_env.cli evaluate --task easy --agents pathqnet:USER/NAME": "hub",
    "drone_env.client": "server",
    "inference.py": "llm",
    "train.py": "train",
    "server/app.py": "server",
    "drone_env/server/app.py": "server",
}
"""What ends for want of an extra, and of which."""


def test_without_extras_every_program_says_in_a_line_which_it_needs(tmp_path: Path) -> None:
    there = sorted({*brought(), *sys.stdlib_module_names, "drone_env"})
    runs = [[str(ROOT / part) if part.endswith(".py") else part for part in run.split()] for run in PROGRAMS]
    done = ran(sys.executable, "-c", BARE, json.dumps([there, runs]), cwd=tmp_path)
    told = dict(zip(PROGRAMS, json.loads(done.stdout).values(), strict=True))
    assert [f"{k}: {v}" for k, v in told.items() if v[1].count("\n") != 1 or v[0] == "0"] == []
    wrong = {program: told[program] for program, extra in PROGRAMS.items() if f"[{extra}]" not in told[program][1]}
    assert wrong == {}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.parametrize("extras", sorted({*NEEDS.values()} - NOT_INSTALLED), ids="+".join)
def test_each_extra_alone_brings_what_its_part_imports(extras: tuple[str, ...]) -> None:
    assert not_brought(extras) == []


def test_extras_bring_what_they_name_and_no_more() -> None:
    assert not distributions() & {"httpx", "torch", "fastapi", "ray", "pytest"}
    assert not distributions("server") & {"torch", "pygame-ce", "matplotlib"}
    left_out = {canonicalize_name(name) for name in LEFT_OUT}
    assert not distributions("llm", "server", "test") & left_out  # `make python` has uv install these
    assert distributions("all") >= distributions("city", "data", "hub", "server", "llm", "train")
    assert {extra for named in NEEDS.values() for extra in named} <= set(PROJECT["optional-dependencies"])
