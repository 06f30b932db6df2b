"""The errors of the package, as they travel between processes: on a cluster, and from workers."""

import inspect
import pickle
from collections.abc import Iterator
from importlib import import_module

import pytest

from drone_env import errors
from drone_env.errors import DroneEnvError

ELSEWHERE = ("client", "llm.endpoint", "llm.limiter", "server.exceptions")
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
