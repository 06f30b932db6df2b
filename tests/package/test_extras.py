"""Each extra alone brings all that its part of the package imports; what needs another says which."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from drone_env import installer
from drone_env.errors import MissingPackageError
from tests.package import extras
from tests.package.extras import PROJECT, brought, extras_named, file_of, imported_later, loaded_by, modules
from tests.tools import LEFT_OUT

NEEDS: Mapping[str, tuple[str, ...]] = {
    "drone_env": (),
    "drone_env.client": ("server",),
    "drone_env.cluster": ("cluster",),
    "drone_env.cluster.senders": ("cluster", "llm"),
    "drone_env.cluster.sweep": ("cluster", "train"),
    "drone_env.llm": ("llm",),
    "drone_env.llm.inspect_task": ("inspect",),
    "drone_env.llm.trl_environment": ("trl",),
    "drone_env.openenv_client": ("server",),
    "drone_env.results.pages": ("llm",),
    "drone_env.rl": ("train",),
    "drone_env.server": ("server",),
}
"""Which extras a module may count on, and all below it that are not named themselves."""
ASKED_FIRST = {"drone_env.cluster.connect"}
"""Who calls these has been told what is missing before anything else is imported."""
LOOKED_FOR = {("drone_env.commands.diagnosis", "torch")}
"""What a module imports only where it has seen that it is there."""
OF_NO_EXTRA = {"stable_baselines3"}


def needs(module: str) -> tuple[str, ...]:
    while module not in NEEDS:
        module = module.rpartition(".")[0]
    return NEEDS[module]


def not_brought() -> list[str]:
    """What importing a module of the package loads, and its extras do not bring."""
    return [
        f"{module} ({', '.join(needs(module)) or 'no extra'}) loads {name}"
        for module in modules()
        for name in sorted(loaded_by(module) - brought(*needs(module)) - OF_NO_EXTRA)
    ]


def unannounced() -> list[str]:
    """What a function imports, no extra of its module brings, and no error of its module says how to get."""
    problems: list[str] = []
    for module in modules():
        for name in imported_later(module):
            own = name if file_of(name) else name.rpartition(".")[0]
            loaded = loaded_by(own) if name.startswith("drone_env") else {name.partition(".")[0]}
            missing = loaded - brought(*needs(module)) - OF_NO_EXTRA - set(sys.stdlib_module_names)
            announced = set(extras_named(module))
            for asked in ASKED_FIRST:
                if any(later.startswith(asked) for later in imported_later(module)):
                    announced |= extras_named(asked)
            missing = {part for part in missing if (module, part) not in LOOKED_FOR}
            if missing and not missing <= brought(*needs(module), *sorted(announced)):
                problems.append(f"{module} imports {name} ({', '.join(sorted(missing))})")
    return problems


BARE = """
import contextlib, io, json, runpy, sys
told, (there, runs) = {}, json.loads(sys.argv[1])

class Bare:
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        return self.finder.find_spec(name, path, target) if name.partition(".")[0] in there or name[0] == "_" else None

sys.meta_path[:] = map(Bare, sys.meta_path)
for program in runs:
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
    runs = [[str(extras.ROOT / part) if part.endswith(".py") else part for part in run.split()] for run in PROGRAMS]
    arguments = [sys.executable, "-c", BARE, json.dumps([there, runs])]
    environment = {**os.environ, "PYTHONPATH": str(extras.ROOT)}
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
        (tmp_path / name).write_bytes((extras.ROOT / name).read_bytes())

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


def test_each_extra_alone_brings_what_its_part_imports() -> None:
    assert not_brought() == []


@pytest.mark.skipif(sys.version_info < (3, 11), reason="3.10 has no Minari, and metadata without the names in wheels")
def test_what_needs_another_extra_says_which() -> None:
    assert unannounced() == []


def test_extras_bring_what_they_name_and_no_more() -> None:
    assert brought() >= {"numpy", "gymnasium", "pydantic", "pydantic_core"}
    assert not brought() & {"httpx", "torch", "fastapi", "ray", "pytest"}
    assert brought("server") >= {"fastapi", "starlette", "uvicorn", "uvloop", "websockets"}
    assert not brought("server") & {"torch", "pygame", "matplotlib"}
    assert not brought("llm", "server", "test") & set(LEFT_OUT)  # `make python` has uv install these
    assert brought("inspect") >= brought("llm") >= {"httpx", "matplotlib", "dotenv"}
    assert not brought("train") & {"fastapi", "httpx", "ray"}
    assert brought("all") >= brought(*(extra for extra in ("city", "data", "human", "server", "llm", "train")))
    assert {extra for named in NEEDS.values() for extra in named} <= set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize(
    ("made_by", "where", "home", "command", "pip"),
    [
        ("uv = 0.13.9", "clone/.venv", "clone", "uv sync --extra train --inexact", "uv pip"),
        ("uv = 0.13.9", "elsewhere", "clone", "uv pip install -e '.[train]'", "uv pip"),
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


FAULTS = {
    "server/predict.py": ("from tenacity import retry", "drone_env.server.app (server) loads tenacity"),
    "core/tasks.py": ("import httpx", "drone_env.core.batch (no extra) loads httpx"),
    "rl/policy.py": ("if 1:\n    import fastapi", "drone_env.rl.trainer (train) loads fastapi"),
    "commands/fly.py": ("def f():\n    import torch", "drone_env.commands.fly imports torch (torch)"),
    "commands/train.py": (
        "def f():\n    from drone_env.server import app",
        "drone_env.commands.train imports drone_env.server.app",
    ),
}


def test_what_is_not_brought_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, changed = extras.imports, {}
    for number, (file, (text, _)) in enumerate(FAULTS.items()):
        found = extras.PACKAGE / file
        changed[found] = tmp_path / f"{number}.py"
        changed[found].write_text(f"{found.read_text(encoding='utf-8')}\n{text}\n", encoding="utf-8")
    monkeypatch.setattr(extras, "imports", lambda file: whole(changed.get(file, file)))
    for kept in (extras.stated, loaded_by):
        kept.cache_clear()
    try:
        told = not_brought() + unannounced()
    finally:
        for kept in (extras.stated, loaded_by):
            kept.cache_clear()
    assert [problem for _, problem in FAULTS.values() if not any(line.startswith(problem) for line in told)] == []
