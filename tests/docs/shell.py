"""Run blocks of shell commands in a copy of the checkout, or check them without running."""

import ast
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from functools import wraps
from importlib.util import find_spec
from itertools import takewhile
from pathlib import Path

import pytest

from drone_env import cli, get_task
from drone_env.commands.arguments import REGISTERED
from drone_env.core.rewards import get_reward_profile
from tests.docs.pages import ROOT, Block
from tests.package.installed import copy_tracked
from tests.tools import ran

SERVERS = ("drone-env serve", "python drone_env/server/app.py")
SCRIPTS = {"train.py": "train", "inference.py": "infer"}
# As in the installed command, modules are not imported from the working directory.
INSTALLED = "import sys; del sys.path[0]; from drone_env.cli import main; sys.exit(main())"
EXIT_STATUS = re.compile(r"#.*\bexit status (\d+)")
# The server ends with the script.
START_SERVER = """{command} --port {port} &
for _ in $(seq 600); do (: < /dev/tcp/127.0.0.1/{port}) 2>/dev/null && break; sleep 0.1; done
"""


def checkout(folder: Path) -> Path:
    """Make a folder with a copy of the checkout, and a `bin` with `python` and `drone-env` beside it."""
    root, programs = folder / "checkout", folder / "bin"
    copy_tracked(root)
    programs.mkdir()
    for name, arguments in {"python": "", "drone-env": f"-c {shlex.quote(INSTALLED)}"}.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {arguments} "$@"\n')
        program.chmod(0o755)
    return root


def commands(block: Block) -> list[str]:
    """Split a block into commands, joining lines that end with a backslash."""
    lines = re.sub(r"\\\n\s*", " ", block.text).splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def commands_to_run(block: Block) -> list[str]:
    """Return the commands of a block that no comment above it skips.

    Raises:
        ValueError: if a comment skips a command that is not in the block.
    """
    every = commands(block)
    unused = [start for start in block.skipped if not any(command.startswith(start) for command in every)]
    if unused:
        raise ValueError(f"{block.where}: no command begins with {unused[0]!r}")
    return [] if block.not_run else [command for command in every if not command.startswith(tuple(block.skipped))]


def script_of(chosen: list[str], reserved_port: Callable[[], int]) -> str:
    """Return a script that runs commands and stops at the first failure.

    Args:
        chosen: The commands. If a comment says `exit status N`, the command must exit with N. Servers run in the
            background on a free port, which replaces port 8000 in all commands.
        reserved_port: Returns a free port.
    """
    lines = ["set -euo pipefail", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    port = reserved_port() if any(command.startswith(SERVERS) for command in chosen) else None
    for written in chosen:
        command = written if port is None else written.replace(":8000", f":{port}")
        lines.append(f"echo {shlex.quote('+ ' + command)} >&2")
        expected = EXIT_STATUS.search(command)
        if command.startswith(SERVERS):
            lines.append(START_SERVER.format(command=shlex.join(shlex.split(command, comments=True)), port=port))
        elif expected:
            lines.append(f"status=0; {{ {command}\n}} || status=$?; [ $status -eq {expected[1]} ]")
        else:
            lines.append(command)
    return "\n".join(lines) + "\n"


def run(script: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a script in a checkout."""
    programs = f"{folder.parent / 'bin'}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return ran("bash", "-c", script, cwd=folder, **environment, PATH=programs)


def check(command: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check a command without running it: options of `drone-env`, make targets and scripts exist.

    Raises:
        AssertionError: if one does not exist.
        ValueError: if quotes are not closed.
    """
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words = list(takewhile(lambda word: not set(word) <= set("();<>|&"), lexer))
    program, *arguments = words or [""]
    if Path(program).name == "drone-env":
        _check_options(arguments, where, monkeypatch)
    elif program == "make":
        done = ran("make", "-n", *arguments)
        assert done.returncode == 0, f"{where}: make {shlex.join(arguments)}: {done.stderr}"
    elif program in ("python", "python3") and arguments and arguments[0].endswith(".py"):
        assert (ROOT / arguments[0]).is_file(), f"{where}: there is no {arguments[0]}"
        if arguments[0] in SCRIPTS:
            _check_options([SCRIPTS[arguments[0]], *arguments[1:]], where, monkeypatch)


def _check_options(arguments: list[str], where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        parse = cli.tyro.cli
        patch.setattr(cli.tyro, "cli", lambda command, **how: parse(wraps(command)(lambda *_, **__: 0), **how))
        for option in REGISTERED:  # earlier commands of the page make the files
            known = get_task("easy") if option == "--task" else get_reward_profile("aligned")
            patch.setitem(REGISTERED, option, lambda file, known=known: known)
        try:
            status = cli.main(arguments)
        except SystemExit as error:
            status = error.code
    assert status in (0, None), f"{where}: drone-env does not understand {shlex.join(arguments)}"


def check_python(code: str, where: str) -> None:
    """Check the syntax of Python code, and that the modules exist that it imports from this package.

    Raises:
        AssertionError: if a module does not exist.
        SyntaxError: if the syntax is invalid.
    """
    for node in ast.walk(ast.parse(code, where)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == "drone_env":
            assert find_spec(node.module), f"{where}: there is no {node.module}"
