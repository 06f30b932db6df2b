"""Blocks of shell commands: taken apart, run in a folder that looks like a checkout, or checked without running."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drone_env import cli, get_task
from drone_env.commands.arguments import REGISTERED, parsed
from drone_env.core.rewards import get_reward_profile
from tests.docs.pages import ROOT, Block

# What is made by running something, or large.
LEFT_OUT = (".*", "__pycache__", "*.egg-info", "build", "data", "demo", "dist", "htmlcov", "results", "runs")
SERVERS = ("drone-env serve", "python drone_env/server/app.py")
DOORS = {"train.py": "train", "inference.py": "infer"}
# As pip installs the command: modules are not looked for in the folder in which it is run.
INSTALLED = "import sys; del sys.path[0]; from drone_env.cli import main; sys.exit(main())"
EXIT_STATUS = re.compile(r"#.*\bexit status (\d+)")
HERE_DOCUMENT = re.compile(r"""<<-?\s*(['"]?)(\w+)\1(.*?)\n.*?^\s*\2$""", re.DOTALL | re.MULTILINE)
# A server in the background, waited for; it ends with the script.
START_SERVER = """{command} --port {port} &
for _ in $(seq 600); do (: < /dev/tcp/127.0.0.1/{port}) 2>/dev/null && break; sleep 0.1; done
"""


def checkout(folder: Path) -> Path:
    """Make a folder with a copy of the checkout, and a `bin` with `python` and `drone-env` beside it."""
    root, programs = folder / "checkout", folder / "bin"
    shutil.copytree(ROOT, root, ignore=shutil.ignore_patterns(*LEFT_OUT), symlinks=True)
    shutil.copy(ROOT / ".env.example", root)
    programs.mkdir()
    for name, arguments in {"python": "", "drone-env": f"-c {shlex.quote(INSTALLED)}"}.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {arguments} "$@"\n')
        program.chmod(0o755)
    return root


def commands(block: Block) -> list[str]:
    """The commands of a block: its lines, those that belong together as one.

    Raises:
        ValueError: if it is no shell script.
    """
    found: list[str] = []
    pending = ""
    for line in block.text.splitlines():
        pending += line + "\n"
        if not _problem(pending):
            if pending.strip() and not pending.lstrip().startswith("#"):
                found.append(pending.strip())
            pending = ""
    if pending:
        raise ValueError(f"{block.where}: {_problem(pending)}")
    return found


def _problem(script: str) -> str:
    if script.rstrip("\n").endswith("\\"):
        return "it ends with a backslash"
    # An open here-document is a mere warning.
    return subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True, check=False).stderr.strip()


def split_skipped(block: Block) -> tuple[list[str], list[str]]:
    """The commands of a block that are to be run, and those that are not.

    Raises:
        ValueError: if a comment above the block skips commands that are not in it.
    """
    every = commands(block)
    if block.not_run:
        return [], every
    unused = [start for start in block.skipped if not any(command.startswith(start) for command in every)]
    if unused:
        raise ValueError(f"{block.where}: no command begins with {unused[0]!r}")
    skipped = [command for command in every if command.startswith(tuple(block.skipped))]
    return [command for command in every if command not in skipped], skipped


def script_of(chosen: list[str], reserved_port: Callable[[], int]) -> str:
    """A script that runs commands and stops at the first that does not do as it should.

    Args:
        chosen: The commands. One whose comment says `exit status N` has to end with that. One that serves is started
            in the background on a port of its own, which takes the place of port 8000 in all of them.
        reserved_port: Gives a port.
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
    variables = {**os.environ, "PYTHONPATH": str(ROOT), **environment, "PATH": programs}
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env=variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def check(command: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What can be known of a command that is not run: programs of ours know its options, targets and paths exist.

    Raises:
        AssertionError: if something in it does not exist.
    """
    for words in _simple_commands(command):
        while words and re.fullmatch(r"[A-Z_][A-Z0-9_]*=.*", words[0]):
            words = words[1:]
        if not words:
            continue
        for word in words:
            _check_path(word, where)
        program, arguments = Path(words[0]).name, words[1:]
        if program == "drone-env":
            _check_options(arguments, where, monkeypatch)
        elif program == "make":
            _check_targets(arguments, where)
        elif program in ("python", "python3") and arguments:
            _check_python(arguments, where, monkeypatch)


def _simple_commands(command: str) -> Iterator[list[str]]:
    """The words of each simple command in a line; what stands between them is dropped."""
    without_documents = HERE_DOCUMENT.sub(r"\3", command)
    lexer = shlex.shlex(without_documents.replace("\\\n", " "), posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    for word in lexer:
        if set(word) <= set("();<>|&"):
            yield words
            words = []
        else:
            words.append(word)
    yield words


def _check_path(word: str, where: str) -> None:
    """A file of the checkout: what begins with the name of one of its folders and ends like a file."""
    folder, slash, _ = word.partition("/")
    ours = slash and (ROOT / folder).is_dir() and folder not in LEFT_OUT and Path(word).suffix
    if ours and not any(sign in word for sign in "*{$"):
        assert (ROOT / word).exists(), f"{where}: there is no {word}"


def _check_options(arguments: list[str], where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(cli, "parsed", lambda *arguments: parsed(*arguments) and bool)  # parses, and calls nothing
        for option in REGISTERED:  # the files are made when the page is run
            known = get_task("easy") if option == "--task" else get_reward_profile("aligned")
            patch.setitem(REGISTERED, option, lambda file, known=known: known)
        try:
            status = cli.main(arguments)
        except SystemExit as error:
            status = error.code
    assert status in (0, None), f"{where}: drone-env does not understand {shlex.join(arguments)}"


def _check_targets(arguments: list[str], where: str) -> None:
    dry = subprocess.run(["make", "-n", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert dry.returncode == 0, f"{where}: make {shlex.join(arguments)}: {dry.stderr}"


def _check_python(arguments: list[str], where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = arguments[0]
    if first.endswith(".py"):
        assert (ROOT / first).is_file(), f"{where}: there is no {first}"
        if first in DOORS:
            _check_options([DOORS[first], *arguments[1:]], where, monkeypatch)
    elif first == "-m" and arguments[1].startswith(("drone_env", "server")):
        module = arguments[1].partition(":")[0].replace(".", "/")
        assert (ROOT / f"{module}.py").is_file() or (ROOT / module).is_dir(), f"{where}: there is no {arguments[1]}"


def check_python(code: str, where: str) -> None:
    """What can be known of Python code without running it: it is Python, and what it takes from here exists.

    Raises:
        AssertionError: if it imports something of this package that does not exist.
        SyntaxError: if it is no Python.
    """
    for node in ast.walk(ast.parse(code, where)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == "drone_env":
            module = ROOT / node.module.replace(".", "/")
            file = module.with_suffix(".py") if module.with_suffix(".py").is_file() else module / "__init__.py"
            assert file.is_file(), f"{where}: there is no {node.module}"
            text = file.read_text(encoding="utf-8")
            for alias in node.names:
                there = re.search(rf"\b{alias.name}\b", text) or (module / f"{alias.name}.py").is_file()
                assert there, f"{where}: {node.module} has no {alias.name}"
