"""The errors of the package, as they travel between processes: on a cluster, and from workers."""

import inspect
import pickle
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from drone_env import errors
from drone_env.errors import DroneEnvError, install_command

ELSEWHERE = ("client", "llm.budget", "llm.endpoint", "server.exceptions")
VALUES: dict[str, object] = {
    "status": 418,
    "retried": True,
    "retry_after": 2.5,
    "fatal": True,
    "allowed": ["b", "a"],
    "given": ("c", 1),
}
"""What constructors get, by the names of their arguments; a text where none is here."""


def kinds() -> Iterator[type[DroneEnvError]]:
    for module in (errors, *(import_module(f"drone_env.{name}") for name in ELSEWHERE)):
        for value in vars(module).values():
            if inspect.isclass(value) and issubclass(value, DroneEnvError) and value.__module__ == module.__name__:
                yield value


def made(kind: type[DroneEnvError]) -> DroneEnvError:
    if "__init__" not in vars(kind):
        return kind("a message")
    return kind(**{name: VALUES.get(name, f"the {name}") for name in list(inspect.signature(kind).parameters)})


@pytest.mark.parametrize("kind", list(kinds()), ids=lambda kind: kind.__name__)
def test_every_error_arrives_as_it_was(kind: type[DroneEnvError]) -> None:
    error = made(kind)
    arrived = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(error))))
    assert type(arrived) is kind
    assert (str(arrived), arrived.args) == (str(error), error.args)
    assert vars(arrived) == vars(error)


@pytest.mark.parametrize(
    ("tool", "folder", "inside", "command"),
    [
        ("uv", ".venv", "clone", "uv sync --extra train"),
        ("uv", "env", "clone", 'uv pip install -e "{clone}[train]"'),
        ("venv", ".venv", "", 'pip install -e "{clone}[train]"'),
        ("uv", None, "", 'uv pip install "drone-delivery-env[train]"'),
    ],
)
def test_the_command_that_adds_an_extra_fits_environment_and_folder(
    tool: str, folder: str | None, inside: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clone = tmp_path / "clone"
    prefix = clone / (folder or ".venv")
    prefix.mkdir(parents=True)
    (prefix / "pyvenv.cfg").write_text("home = /usr/bin\n" + ("uv = 0.13.9\n" if tool == "uv" else ""))
    if folder is not None:
        (clone / "uv.lock").touch()
    monkeypatch.setattr(sys, "prefix", str(prefix))
    monkeypatch.setattr(errors, "__file__", str(clone / "drone_env" / "errors.py"))
    monkeypatch.chdir(tmp_path / inside)
    assert install_command("train") == command.format(clone=clone)
