"""What to type: commands of this environment, and of the installer that made it.

It imports nothing but the standard library: scripts of a clone run it where the package itself cannot be imported.
"""

import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

DISTRIBUTION = "drone-delivery-env"
"""What an index and an installer call this package; it is imported as `drone_env`."""
CLONE = Path(__file__).resolve().parents[1]
"""The clone that this is part of; where there is no clone, the folder in which packages are installed."""


def program(name: str) -> str:
    """What to type for a program of this environment: its name if the shell finds it, else its path."""
    here, found = Path(sys.executable).with_name(name), shutil.which(name)
    if found is not None and Path(found).parent == here.parent:
        return name
    return str(here.relative_to(Path.cwd()) if here.is_relative_to(Path.cwd()) else here)


def missing(error: ModuleNotFoundError, extra: str = "") -> str:
    """What a script of the clone prints where a package is missing.

    Args:
        error: The import that failed.
        extra: What the script needs beside the package's own dependencies.
    """
    command = install_command(extra)
    if sys.prefix == sys.base_prefix:  # no virtual environment, and many systems allow no installation outside of one
        there = (CLONE / ".venv" / "bin" / "activate").exists()
        new = f"python3 -m venv .venv && . .venv/bin/activate && pip install -e {_with(extra)}"
        command = ". .venv/bin/activate" if there else new
    return f"{error.name} is not installed; {_typed(command)}"


def how_to_install(extra: str) -> str:
    """What to type to have an extra."""
    return _typed(install_command(extra))


def _typed(command: str) -> str:
    return f"type{f' in {CLONE}' if _is_a_clone() and Path.cwd() != CLONE else ''}: {command}"


def install_command(extra: str) -> str:
    """What brings an extra, typed in the clone if there is one: of uv where uv made this environment, else of pip."""
    if not _is_a_clone():
        return f"{pip()} install '{DISTRIBUTION}[{extra}]'"
    if not _is_of_uv():
        return f"{program('pip')} install -e {_with(extra)}"
    project = CLONE / os.environ.get("UV_PROJECT_ENVIRONMENT", ".venv")
    if project.resolve() == Path(sys.prefix).resolve():
        # Exact, as it is by itself, it would take away what other extras brought.
        return f"uv sync{f' --extra {extra}' if extra else ''} --inexact"
    return f"uv pip install -e {_with(extra)}"


def _with(extra: str) -> str:
    return f"'.[{extra}]'" if extra else "."


def pip() -> str:
    """`pip` of this environment, or what stands for it in an environment of uv, which has none."""
    return "uv pip" if _is_of_uv() else program("pip")


def _is_a_clone() -> bool:
    return (CLONE / "pyproject.toml").is_file()


def _is_of_uv() -> bool:
    made = Path(sys.prefix) / "pyvenv.cfg"
    lines = made.read_text(encoding="utf-8").splitlines() if made.is_file() else []
    return any(line.partition("=")[0].strip() == "uv" for line in lines) or find_spec("pip") is None
