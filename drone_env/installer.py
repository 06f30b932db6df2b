"""How more is installed, in the words of the installer that made this environment."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

CLONE = Path(__file__).resolve().parents[1]


def install_command(extra: str) -> str:
    """What brings an extra, typed in the clone: a command of uv where uv made this environment, else of pip."""
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


def _is_of_uv() -> bool:
    made = Path(sys.prefix) / "pyvenv.cfg"
    lines = made.read_text(encoding="utf-8").splitlines() if made.is_file() else []
    return any(line.partition("=")[0].strip() == "uv" for line in lines) or find_spec("pip") is None
