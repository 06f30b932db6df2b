"""The exceptions of this package.

    DroneEnvError
    ├── UnknownNameError      (also a LookupError)  no such task, profile, agent or split
    ├── InvalidValueError     (also a ValueError)   an invalid seed, action or option
    │   └── InvalidTaskError                        a TaskConfig or RewardProfile that contradicts itself
    ├── EpisodeError          (also a RuntimeError) a call that does not fit the state of the episode
    ├── AgentError            (also a RuntimeError) the code of an agent failed
    ├── UnsupportedTaskError  (also a ValueError)   a planner does not cover the mechanics of a task
    ├── TooLargeError         (also a ValueError)   an exact solution would not fit into memory
    ├── MissingPackageError   (also an ImportError) a package of an extra is not installed
    ├── CheckpointError       (also a ValueError)   not a checkpoint, cut short, or of another run
    ├── StoreError            (also an OSError)     a store cannot be opened, read or written
    ├── NoSessionError        (also a LookupError)  a session has ended, expired or never existed
    ├── CapacityError         (also a RuntimeError) too many sessions
    ├── ClusterError          (also a RuntimeError) a cluster cannot be reached, or its nodes differ
    └── EndpointError         (also a RuntimeError) an endpoint of language models refuses every call

Each message names the given value and the allowed ones.
"""

import sys
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any

DISTRIBUTION = "drone-delivery-env"
"""The name of this package in an index; it is imported as `drone_env`."""


class DroneEnvError(Exception):
    """Base class of all errors of this package. All can be pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        # By default, unpickling passes the message to `__init__`, whose parameters may differ.
        return _restored, (type(self), self.args), vars(self)


def _restored(kind: type[DroneEnvError], args: tuple[Any, ...]) -> DroneEnvError:
    return kind.__new__(kind, *args)


class UnknownNameError(DroneEnvError, LookupError):
    """A name that is not in a registry.

    The message suggests the most similar name and lists `allowed`. Names in `also` are suggested but not listed.
    """

    def __init__(self, kind: str, given: object, allowed: Iterable[str], also: Iterable[str] = ()) -> None:
        self.kind = kind
        self.given = given
        self.allowed = sorted(set(allowed))
        close = get_close_matches(f"{given}".lower(), [*self.allowed, *also], 1)
        meant = f"did you mean {close[0]!r}? " if close else ""
        known = f"unknown {kind} {given!r}; {meant}allowed: {', '.join(self.allowed)}"
        super().__init__(known if self.allowed else f"there is no {kind} {given!r}")


class InvalidValueError(DroneEnvError, ValueError):
    """A value that is not allowed."""


class InvalidTaskError(InvalidValueError):
    """A task or reward profile whose numbers contradict each other."""


class EpisodeError(DroneEnvError, RuntimeError):
    """A call that does not fit the state of the episode, such as a step before the first reset."""


class AgentError(DroneEnvError, RuntimeError):
    """The code of an agent raised an exception, the cause.

    Attributes:
        trace: Traceback of the agent's code as text, because causes are not pickled.
    """

    def __init__(self, message: str, trace: str = "") -> None:
        super().__init__(message)
        self.trace = trace


class TooLargeError(DroneEnvError, ValueError):
    """An exact solution would take more memory than is allowed."""


class CheckpointError(DroneEnvError, ValueError):
    """A file that is not a checkpoint, is cut short or too new, or belongs to another run."""


class UnsupportedTaskError(DroneEnvError, ValueError):
    """A planner does not cover the mechanics of a task."""


class MissingPackageError(DroneEnvError, ImportError):
    """A package of an extra is not installed; the message contains the command that installs it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; run: {install_command(extra)}")


class StoreError(DroneEnvError, OSError):
    """A file that is not a store, is newer than this package, or cannot be read or written."""


class NoSessionError(DroneEnvError, LookupError):
    """A session that has ended or expired, or never existed."""


class CapacityError(DroneEnvError, RuntimeError):
    """The maximum number of sessions is open."""


class ClusterError(DroneEnvError, RuntimeError):
    """A cluster cannot be reached, refuses a job, or has nodes with another version of this package."""


class EndpointError(DroneEnvError, RuntimeError):
    """An endpoint of language models refuses every call: a wrong token, an unknown model."""


def install_command(extra: str) -> str:
    """Return the command that adds an extra to this environment, by pip or uv, from the checkout if there is one."""
    root, chosen, made_by = Path(__file__).parents[1], f"[{extra}]" if extra else "", Path(sys.prefix, "pyvenv.cfg")
    tool = "uv pip" if made_by.is_file() and "\nuv = " in made_by.read_text("utf-8") else "pip"
    if not (root / "uv.lock").is_file():  # the tools take the installed package, and need no index for it
        return f'{tool} install "{DISTRIBUTION}{chosen}"'
    if tool == "uv pip" and Path(sys.prefix) == root / ".venv" and Path.cwd() == root:
        return f"uv sync --extra {extra}" if extra else "uv sync"
    return f'{tool} install -e "{root}{chosen}"'


def abbreviate(value: object) -> str:
    """Return the `repr` of an untrusted value for a message, cut to 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def text_of(error: Any, name: Callable[[str], str] = str) -> str:
    """Describe the first five invalid parts: `part: reason; part: reason`.

    Args:
        error: The validation error.
        name: Converts the name of a part, such as `body.direction`, for people.
    """
    told: list[str] = []
    for wrong in error.errors()[:5]:
        part, reason = ".".join(str(one) for one in wrong["loc"] if one != "[key]"), wrong["msg"]
        told.append((f"{name(part)}: " if part else "") + reason.removeprefix("Value error, "))
    return "; ".join(told)


@contextmanager
def needs(extra: str, module: str = "") -> Generator[None, None, None]:
    """Name an extra if an import inside the `with` fails.

    Args:
        extra: The extra that installs the imported packages.
        module: `__name__` of a file that may be run as a program; if it is run, it prints the message and exits.

    Raises:
        MissingPackageError: if a third-party package is missing.
    """
    try:
        yield
    except (ModuleNotFoundError, MissingPackageError) as error:
        package = (error.name or "").partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and package in ("", "drone_env"):
            raise
        missing = error if isinstance(error, MissingPackageError) else MissingPackageError(package, extra)
        if module == "__main__":
            sys.exit(f"drone-env: {missing}")
        raise missing from None
