"""Every exception that this package raises on purpose.

    DroneEnvError
    ├── UnknownNameError      (also a LookupError)  a task, profile, agent or split that does not exist
    ├── InvalidValueError     (also a ValueError)   a seed, action or option outside what is allowed
    │   └── InvalidTaskError                        a TaskConfig or RewardProfile that contradicts itself
    ├── EpisodeError          (also a RuntimeError) a call that does not fit the episode's state
    ├── AgentError            (also a RuntimeError) an agent of one's own whose code failed
    ├── UnsupportedTaskError  (also a ValueError)   a planner asked about a task whose mechanics it does not cover
    ├── TooLargeError         (also a ValueError)   an exact solution that would not fit into memory
    ├── MissingPackageError   (also an ImportError) a package of an extra that is not installed
    ├── CheckpointError       (also a ValueError)   a file that is no checkpoint, cut short, or of another run
    ├── StoreError            (also an OSError)     a store that cannot be opened, read or written
    ├── NoSessionError        (also a LookupError)  a session that never was
    ├── SessionGoneError      (also a LookupError)  a session that has ended or expired
    ├── CapacityError         (also a RuntimeError) one more session than there is room for
    ├── ClusterError          (also a RuntimeError) a cluster that cannot be reached, or whose nodes differ
    └── EndpointError         (also a RuntimeError) an endpoint of language models that refuses every call

Each message says what was given and what is allowed.
"""

import sys
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any, Protocol

DISTRIBUTION = "drone-delivery-env"
"""The name of this package in an index; it is imported as `drone_env`."""


class DroneEnvError(Exception):
    """Base class of all errors of this package. They travel between processes, whatever their constructors take."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _again, (type(self), self.args, vars(self))


def _again(kind: type[DroneEnvError], args: tuple[Any, ...], attributes: dict[str, Any]) -> DroneEnvError:
    """An error from its parts: Python would call the class with the message alone."""
    error = kind.__new__(kind, *args)
    builtin = next(base for base in kind.__mro__ if base.__module__ == "builtins")
    builtin.__init__(error, *args)
    vars(error).update(attributes)
    return error


class UnknownNameError(DroneEnvError, LookupError):
    """A name that is not in a registry.

    The message names the most similar one that is, and lists all, unless none are given. Names in `also` are compared
    and not listed.
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
    """A value outside what is allowed."""


class InvalidTaskError(InvalidValueError):
    """A task or reward profile whose numbers contradict each other."""


class EpisodeError(DroneEnvError, RuntimeError):
    """A call that does not fit the state of the episode, such as a step before the first reset."""


class AgentError(DroneEnvError, RuntimeError):
    """The code of an agent failed; the cause is what it raised.

    Attributes:
        trace: Its traceback as text, from the agent's own code on: it travels between processes, which causes do not.
    """

    def __init__(self, message: str, trace: str = "") -> None:
        super().__init__(message)
        self.trace = trace


class TooLargeError(DroneEnvError, ValueError):
    """An exact solution would take more memory than is allowed."""


class CheckpointError(DroneEnvError, ValueError):
    """A file that is no checkpoint, is cut short or too new, or belongs to another run."""


class UnsupportedTaskError(DroneEnvError, ValueError):
    """A planner was asked about a task whose mechanics it does not cover."""


class MissingPackageError(DroneEnvError, ImportError):
    """A package that only an extra installs; the message says how."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; run: {install_command(extra)}")


class StoreError(DroneEnvError, OSError):
    """A store that is no store, is newer than this package, or cannot be read or written now."""


class NoSessionError(DroneEnvError, LookupError):
    """A session id that was never given out, or so long ago that it is forgotten."""


class SessionGoneError(DroneEnvError, LookupError):
    """A session that has been ended or has expired."""


class CapacityError(DroneEnvError, RuntimeError):
    """As many sessions are open as are allowed."""


class ClusterError(DroneEnvError, RuntimeError):
    """A cluster that cannot be reached, refuses, or has nodes with another version of this package."""


class EndpointError(DroneEnvError, RuntimeError):
    """An endpoint of language models refuses, so that no further call makes sense: a wrong token, no such model."""


def install_command(extra: str) -> str:
    """Return the command that installs this package with an extra."""
    return f'pip install "{DISTRIBUTION}{f"[{extra}]" if extra else ""}"'


def shown(value: object) -> str:
    """A value that somebody else wrote, for a message: its `repr`, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


class Invalid(Protocol):
    """What Pydantic raises for a value that does not fit a model, and FastAPI for a request."""

    def errors(self) -> Sequence[Any]:
        """What is wrong, part by part."""
        ...


LONGEST_NAME = 200
"""Characters: whoever sends a value names its parts."""


def wrong_parts(error: Invalid) -> list[tuple[str, str, str]]:
    """The first 20 parts that are wrong: the name, such as `body.direction` and empty for the whole; why; the kind."""
    return [
        (".".join(map(str, part["loc"]))[:LONGEST_NAME], part["msg"].removeprefix("Value error, "), part["type"])
        for part in error.errors()[:20]
    ]


def text_of(error: Invalid, name: Callable[[str], str] = str) -> str:
    """The first five parts that are wrong, for people: `where: why; where: why`.

    Args:
        error: What was raised.
        name: What people call a part; an empty name is not written.
    """
    named = [(where and name(where), why) for where, why, _ in wrong_parts(error)[:5]]
    return "; ".join(f"{called}: {why}" if called else why for called, why in named)


@contextmanager
def needs(extra: str, module: str = "") -> Generator[None, None, None]:
    """What is imported inside the `with` comes with an extra: where it is missing, the error says so.

    Args:
        extra: The extra.
        module: `__name__` of a file that may be run as a program: it then ends with the message alone.

    Raises:
        MissingPackageError: if a package from elsewhere is missing.
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
