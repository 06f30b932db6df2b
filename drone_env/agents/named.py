"""Agents outside the registry: classes and functions of your own, and policies of Stable-Baselines3."""

import hashlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, cast

from drone_env.agents.base import Agent, named_failures
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnknownNameError

SB3_FILE = re.compile(r"(?P<file>.+\.zip)(:(?P<wrapper>[\w.]+(:(?!sampled$)\w+)?))??(?P<sampled>:sampled)?")
ADDRESS = re.compile(r" at 0x[0-9a-f]+")
MODULE = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)")


class FunctionAgent:
    """A function of the observation as an agent; a stochastic one has a true attribute `stochastic`.

    Args:
        act: Returns an action, 0 to 4.
        config: The configuration as JSON values.
    """

    def __init__(self, act: Callable[[Observation], int], config: Mapping[str, object]) -> None:
        self._act = act
        self.config = config
        self.stochastic = bool(getattr(act, "stochastic", False))

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """The function's action."""
        return self._act(observation)


def sb3_file(name: str) -> Path | None:
    """The file of Stable-Baselines3 in the name of an agent; None if there is none."""
    found = SB3_FILE.fullmatch(name)
    return None if found is None else Path(found["file"])


def sb3_elsewhere(name: str, file: Path) -> str:
    """The name of an agent after its file of Stable-Baselines3 is moved."""
    found = SB3_FILE.fullmatch(name)
    return name if found is None else f"{file}{name[found.end('file') :]}"


def agent_named(name: str, task: TaskConfig) -> Agent | None:
    """The agent of `MODULE:NAME`, `FILE.zip`, `FILE.zip:WRAPPER`, or one of the latter two with `:sampled`.

    A class is made for the task, a function is called for each action, anything else is an agent. Modules come from
    Python's path or the working directory. None if a name has none of these forms.

    Raises:
        UnknownNameError: if there is no such wrapper.
        InvalidValueError: if there is no such module, or no agent of that name in it.
        OSError: if the file cannot be read.
        CheckpointError: if it contains no policy for the task.
    """
    zipped, mine = SB3_FILE.fullmatch(name), MODULE.fullmatch(name)
    if zipped is not None:
        from drone_env.agents.sb3_policy import load_policy

        wrapper = zipped["wrapper"] and _wrapper(zipped["wrapper"])
        return load_policy(Path(zipped["file"]), task, wrapper, sampled=zipped["sampled"] is not None)
    return None if mine is None else as_agent(_member(mine["module"], mine["name"], f"agent {name!r}"), task)


def as_agent(policy: Any, task: TaskConfig, wrapper: Any = None, sampled: bool = False) -> Agent:
    """Make an agent of anything that can fly.

    Args:
        policy: An agent, a class of one, a function of the observation, or a model of Stable-Baselines3.
        task: The task.
        wrapper: The wrapper in a model's training, or its name.
        sampled: Whether a model samples its actions; else it takes the likeliest.

    Raises:
        UnknownNameError: if there is no such wrapper.
        InvalidValueError: if it is none of these or a class without a task, an argument needs a model, or the model
            needs normalised observations.
        AgentError: if the constructor of a class fails.
        CheckpointError: if the model takes other observations than the wrapped task has.
    """
    if hasattr(policy, "predict") and hasattr(policy, "observation_space"):
        from drone_env.agents.sb3_policy import Sb3Agent

        normalised = policy.get_vec_normalize_env() if hasattr(policy, "get_vec_normalize_env") else None
        if normalised is not None and normalised.norm_obs:
            raise InvalidValueError(
                "this model sees what VecNormalize makes of observations: train it with norm_obs=False, or write an "
                "agent of your own that normalises likewise"
            )
        chosen = _wrapper(wrapper) if isinstance(wrapper, str) else wrapper
        return Sb3Agent(task, getattr(policy, "policy", policy), chosen, sampled)
    if wrapper is not None or sampled:
        raise InvalidValueError(f"wrapper and sampled are said of a model of Stable-Baselines3, got {policy!r}")
    made = policy
    if isinstance(policy, type):
        with named_failures(policy.__qualname__, task, lambda: "when made for a task"):
            made = policy(task)
    if callable(getattr(made, "act", None)) and callable(getattr(made, "reset", None)):
        if getattr(made, "config", None) is None:
            made.config = _identity(type(made))
        return made
    if callable(made) and not isinstance(policy, type):
        return FunctionAgent(cast(Callable[[Observation], int], made), _identity(made))
    takes = "a function of the observation, an agent (reset, act), a class of one, or a model of Stable-Baselines3"
    raise InvalidValueError(f"what flies is {takes}; got {policy!r}")


def _identity(made: Any) -> dict[str, object]:
    """The identity of code: its name and a digest of its module's file.

    Without such a file, as in a REPL, the digest covers the code itself; it is null for code in C. A `partial` adds its
    arguments.
    """
    if isinstance(made, partial):
        bound = cast("partial[Any]", made)
        return {**_identity(bound.func), "bound": ADDRESS.sub("", f"{bound.args} {bound.keywords}")}
    module = getattr(made, "__module__", None) or "builtins"
    file = getattr(sys.modules.get(module), "__file__", None)
    held = Path(file).read_bytes() if file and Path(file).is_file() else _code(made)
    source = hashlib.sha256(held).hexdigest()[:16] if held else None
    return {"agent": f"{module}:{getattr(made, '__qualname__', type(made).__qualname__)}", "source": source}


def _code(made: Any) -> bytes:
    """The instructions of code as bytes, independent of its place in a file; empty for code in C."""
    if isinstance(made, CodeType):
        inner = b"".join(_code(one) if isinstance(one, CodeType) else repr(one).encode() for one in made.co_consts)
        return made.co_code + repr(made.co_names).encode() + inner
    if hasattr(made, "__code__"):
        return _code(made.__code__)
    members = vars(made if isinstance(made, type) else type(made))
    return b"".join(_code(one) for _, one in sorted(members.items()) if hasattr(one, "__code__"))


def _wrapper(name: str) -> Any:
    """A wrapper of this package by its name, or of any module as `MODULE:NAME`."""
    if ":" in name:
        module, _, member = name.partition(":")
        return _member(module, member, f"wrapper {name!r}")
    from drone_env.agents.sb3_policy import AT_ONCE

    shipped = {wrapper.__name__: wrapper for wrapper in AT_ONCE if wrapper is not None}
    if name not in shipped:
        raise UnknownNameError("wrapper", name, [*shipped, "MODULE:NAME"])
    return shipped[name]


def _member(module: str, name: str, what: str) -> Any:
    imported = _imported(module, what)
    if not hasattr(imported, name):
        raise InvalidValueError(f"{what}: {imported.__file__} has no {name!r}")
    return getattr(imported, name)


def _imported(module: str, what: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # at the end: what lies here hides nothing that is installed
    try:
        return import_module(module)
    except (Exception, SystemExit) as error:  # whatever a module does while it is imported
        told = f"{type(error).__name__}: {error}"
        raise InvalidValueError(f"{what}: module {module!r} could not be imported: {told}") from error
