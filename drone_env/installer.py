"""How more is installed, in the words of the installer that made this environment."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

DISTRIBUTION = "drone-delivery-env"
"""What an index and an installer call this package; it is imported as `drone_env`."""
CLONE = Path(__file__).resolve().parents[1]
"""The clone that this is part of; where there is no clone, the folder in which packages are installed."""


def how_to_install(extra: str) -> str:
    """What to do to have an extra: the command, and where it is to be typed if that matters."""
    return f"run {install_command(extra)}{' in the clone' if _is_a_clone() else ''}"


def install_command(extra: str) -> str:
    """What brings an extra, typed in the clone if there is one: of uv where uv made this environment, else of pip."""
    if not _is_a_clone():
        return f"{pip()} install '{DISTRIBUTION}[{extra}]'"
    if not _is_of_uv():
        return f"pip install -e '.[{extra}]'"
    project = CLONE / os.environ.get("UV_PROJECT_ENVIRONMENT", ".venv")
    if project.resolve() == Path(sys.prefix).resolve():
        # Exact, as it is by itself, it would take away what other extras brought.
        return f"uv sync --extra {extra} --inexact"
    return f"uv pip install -e '.[{extra}]'"


def pip() -> str:
    """`pip`, or what stands for it in an environment of uv, which has none."""
    return "uv pip" if _is_of_uv() else "pip"


def _is_a_clone() -> bool:
    return (CLONE / "pyproject.toml").is_file()


def _is_of_uv() -> bool:
    made = Path(sys.prefix) / "pyvenv.cfg"
    lines = made.read_text(encoding="utf-8").splitlines() if made.is_file() else []
    return any(line.partition("=")[0].strip() == "uv" for line in lines) or find_spec("pip") is None
