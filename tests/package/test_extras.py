"""Each extra alone brings all that its part of the package imports; what needs another says which."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from drone_env import installer
from drone_env.errors import MissingPackageError
from tests.package.extras import PROJECT, ROOT, brought
from tests.tools import LEFT_OUT

NEEDS: Mapping[str, tuple[str, ...]] = {
    "drone_env": (),
    "drone_env.client": ("server",),
    "drone_env.cluster": ("cluster",),
    "drone_env.cluster.senders": ("cluster", "llm"),
    "drone_env.llm": ("llm",),
    "drone_env.llm.inspect_task": ("inspect",),
    "drone_env.llm.trl_environment": ("trl",),
    "drone_env.openenv_client": ("server",),
    "drone_env.results.pages": ("llm",),
    "drone_env.rl": ("train",),
    "drone_env.server": ("server",),
}
"""Which extras a module may count on, and all below it that are not named themselves."""


ALL = sorted({extra for extras in NEEDS.values() for extra in extras})
NOT_INSTALLED = {"inspect", "trl"}
"""Extras that are no part of the development tools."""


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


def not_brought(extras: tuple[str, ...], *more: str) -> list[str]:
    """The modules that cannot be imported with these extras alone."""
    # The last two are in Ray.
    there = sorted({*brought(*extras), *sys.stdlib_module_names, "drone_env", "colorama", "psutil"})
    parts = [module for module in modules() if needs(module) == extras]
    command = [sys.executable, "-c", IMPORT, json.dumps([there, [*parts, *more]])]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
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
    "drone_env.cli sweep --task easy --set lr=1e-3 --out x": "train",
    "drone_env.cli dataset --task easy --maps 1 --out x": "data",
    "drone_env.cli city x.osm --out y.toml": "city",
    "drone_env.cli evaluate --engine ray --task easy": "cluster",
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
    arguments = [sys.executable, "-c", BARE, json.dumps([there, runs])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    told = dict(zip(PROGRAMS, json.loads(done.stdout).values(), strict=True))
    assert [f"{k}: {v}" for k, v in told.items() if v[1].count("\n") != 1 or v[0] == "0"] == []
    # Without pip, as here, the hint is one of uv.
    command = {program: re.compile(rf"\[{extra}\]|--extra {extra}\b") for program, extra in PROGRAMS.items()}
    wrong = {program: told[program] for program in PROGRAMS if not command[program].search(told[program][1])}
    assert wrong == {}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("script", "extra"), [("train.py", "[train]"), ("inference.py", "[llm]"), ("check_graders.py", "")]
)
def test_scripts_of_a_clone_without_any_package_say_what_to_type(script: str, extra: str, tmp_path: Path) -> None:
    for name in ("drone_env/__init__.py", "drone_env/installer.py", "pyproject.toml", script):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())

    def told() -> str:
        # Without `site`, Python finds no packages but its own.
        command = [sys.executable, "-S", "-B", script]
        done = subprocess.run(command, cwd=tmp_path, env={"PATH": os.environ["PATH"]}, capture_output=True, text=True)
        assert done.returncode == 1
        return done.stderr

    install = f"'.{extra}'" if extra else "."
    new = rf"type: python3 -m venv \.venv && \. \.venv/bin/activate && pip install -e {re.escape(install)}\n"
    assert re.fullmatch(rf"{script}: \S+ is not installed; {new}", told())
    (tmp_path / ".venv/bin").mkdir(parents=True)
    (tmp_path / ".venv/bin/activate").touch()
    assert re.fullmatch(rf"{script}: \S+ is not installed; type: \. \.venv/bin/activate\n", told())


@pytest.mark.parametrize("extras", sorted({*NEEDS.values()}), ids="+".join)
def test_each_extra_alone_brings_what_its_part_imports(extras: tuple[str, ...]) -> None:
    if NOT_INSTALLED & {*extras}:
        pytest.skip("not a development tool")
    assert not_brought(extras) == []


def test_extras_bring_what_they_name_and_no_more() -> None:
    assert not brought() & {"httpx", "torch", "fastapi", "ray", "pytest"}
    assert not brought("server") & {"torch", "pygame", "matplotlib"}
    assert not brought("llm", "server", "test") & set(LEFT_OUT)  # `make python` has uv install these
    assert brought("all") >= brought(*(extra for extra in ("city", "data", "server", "llm", "train")))
    assert {extra for named in NEEDS.values() for extra in named} <= set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize(
    ("made_by", "where", "home", "command", "pip"),
    [
        ("uv = 0.13.9", "clone/.venv", "clone", "uv sync --extra train --inexact", "uv pip"),
        ("version = 3.11.2", "clone/.venv", "clone", "pip install -e '.[train]'", "pip"),
        ("uv = 0.13.9", "elsewhere", "elsewhere/lib", "uv pip install 'drone-delivery-env[train]'", "uv pip"),
        ("version = 3.11.2", "elsewhere", "elsewhere/lib", "pip install 'drone-delivery-env[train]'", "pip"),
    ],
)
def test_what_brings_an_extra_is_a_command_of_the_installer_in_use(
    made_by: str, where: str, home: str, command: str, pip: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / where).mkdir(parents=True)
    (tmp_path / "clone").mkdir(exist_ok=True)
    (tmp_path / "clone" / "pyproject.toml").touch()
    (tmp_path / where / "pyvenv.cfg").write_text(f"home = /usr/bin\n{made_by}\n")
    monkeypatch.delenv("UV_PROJECT_ENVIRONMENT", raising=False)
    monkeypatch.setattr(installer, "CLONE", tmp_path / home)
    monkeypatch.setattr(installer, "program", lambda name: name)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / where))
    place = f" in {tmp_path / home}" if home == "clone" else ""
    assert str(MissingPackageError("torch", "train")) == f"torch is not installed; type{place}: {command}"
    assert installer.pip() == pip
