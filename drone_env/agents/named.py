"""Agents outside the registry: your own classes and functions, and models of Stable-Baselines3."""

import hashlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from inspect import getsource
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

from drone_env.agents.base import Agent, named_failures
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError

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


def agent_named(name: str, task: TaskConfig) -> Agent | None:
    """The agent of `MODULE:NAME`; None if a name is not of that form.

    Modules are imported from Python's path or the working directory.

    Raises:
        InvalidValueError: if there is no such module, or no agent of that name in it.
        UnsupportedTaskError: if it is a model for other observations.
    """
    match = MODULE.fullmatch(name)
    return as_agent(_member(match["module"], match["name"], f"agent {name!r}"), task) if match else None


def as_agent(policy: Any, task: TaskConfig) -> Agent:
    """Make an agent of a policy.

    Args:
        policy: An agent, a class of one (it gets the task), a function of the observation, or a model of
            Stable-Baselines3.
        task: The task.

    Raises:
        InvalidValueError: if it is none of these or a class without a task, or the model needs normalised observations.
        AgentError: if the constructor of a class fails.
        UnsupportedTaskError: if the model takes other observations than the task has.
    """
    if hasattr(policy, "predict") and hasattr(policy, "observation_space"):
        from drone_env.agents.sb3_policy import Sb3Agent

        return Sb3Agent(task, policy)
    agent = policy
    if isinstance(policy, type):
        with named_failures(policy.__qualname__, task, lambda: "constructor"):
            agent = policy(task)
    if callable(getattr(agent, "act", None)) and callable(getattr(agent, "reset", None)):
        if getattr(agent, "config", None) is None:
            agent.config = _identity(type(agent))
        return agent
    if callable(agent) and not isinstance(policy, type):
        return FunctionAgent(cast(Callable[[Observation], int], agent), _identity(agent))
    allowed = "a function of the observation, an object or class with reset and act, or a model of Stable-Baselines3"
    raise InvalidValueError(f"an agent is {allowed}; got {policy!r}")


def _identity(policy: Any) -> dict[str, object]:
    """The identity of code: its name and a digest of its module's file. A `partial` adds its arguments.

    Code without such a file, as in a REPL, is identified by its source text; without that, each time is another one.
    """
    if isinstance(policy, partial):
        bound = cast("partial[Any]", policy)
        return {**_identity(bound.func), "bound": ADDRESS.sub("", f"{bound.args} {bound.keywords}")}
    module = getattr(policy, "__module__", None) or "builtins"
    file = getattr(sys.modules.get(module), "__file__", None)
    code: Any = policy if hasattr(policy, "__qualname__") else policy.__class__
    try:
        content = Path(file).read_bytes() if file and Path(file).is_file() else getsource(code).encode()
    except (OSError, TypeError):
        content = uuid4().bytes
    return {"agent": f"{module}:{code.__qualname__}", "source": hashlib.sha256(content).hexdigest()[:16]}


def _member(module: str, name: str, user: str) -> Any:
    """A member of a module; `user` is what needs it, for errors."""
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that installed packages have priority
    try:
        imported = import_module(module)
    except (Exception, SystemExit) as error:  # importing a module runs any code
        reason = f"{type(error).__name__}: {error}"
        raise InvalidValueError(f"{user}: cannot import module {module!r}: {reason}") from error
    if not hasattr(imported, name):
        raise InvalidValueError(f"{user}: {imported.__file__} has no {name!r}")
    return getattr(imported, name)
