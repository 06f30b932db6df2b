"""The errors of the package, as they travel between processes: on a cluster, and from workers."""

import inspect
import pickle
from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module

import pytest

from drone_env import errors
from drone_env.errors import DroneEnvError, MissingPackageError, UnknownNameError

ELSEWHERE = ("client", "llm.endpoint", "llm.limiter", "server.problems")
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
@pytest.mark.parametrize(
    "travel", [lambda error: pickle.loads(pickle.dumps(error)), deepcopy], ids=["pickle", "deepcopy"]
)
def test_every_error_arrives_as_it_was(kind: type[DroneEnvError], travel: object) -> None:
    error = made(kind)
    assert callable(travel)
    arrived = travel(error)
    assert type(arrived) is kind
    assert (str(arrived), arrived.args) == (str(error), error.args)
    assert vars(arrived) == vars(error)


def test_so_do_their_details() -> None:
    unknown = pickle.loads(pickle.dumps(UnknownNameError("task", "eazy", ["hard", "easy"])))
    assert (unknown.kind, unknown.given, unknown.allowed) == ("task", "eazy", ["easy", "hard"])
    missing = pickle.loads(pickle.dumps(MissingPackageError("Ray", "cluster")))
    assert missing.msg == str(missing)
    assert missing.msg.startswith("Ray is not installed")
    twice = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(unknown))))
    assert "did you mean 'hard_delivery'? allowed: hard" in str(
        UnknownNameError("task", "Hard_delivry", ["hard"], also=["hard_delivery"])
    )
    assert str(twice) == "unknown task 'eazy'; did you mean 'easy'? allowed: easy, hard"
