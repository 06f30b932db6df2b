"""Agents that no registry holds: one of your own module, a function, and policies of Stable-Baselines3."""

import hashlib
import re
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from drone_env.agents.base import Agent
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError

SB3_FILE = re.compile(r"(?P<file>.+\.zip)(:(?P<wrapper>[\w.]+(:(?!sampled$)\w+)?))??(?P<sampled>:sampled)?")
MODULE = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)")


class FunctionAgent:
    """A function of the observation as an agent. One that draws lots has an attribute `stochastic` that is true.

    Args:
        act: Chooses an action, 0 to 4.
        config: All that decides how it flies, as JSON values.
    """

    def __init__(self, act: Callable[[Observation], int], config: Mapping[str, object]) -> None:
        self._act = act
        self.config = config
        self.stochastic = bool(getattr(act, "stochastic", False))

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """What the function says."""
        return self._act(observation)


def sb3_file(name: str) -> Path | None:
    """The file of Stable-Baselines3 that a name of an agent names; None where it names none."""
    found = SB3_FILE.fullmatch(name)
    return None if found is None else Path(found["file"])


def sb3_elsewhere(name: str, file: Path) -> str:
    """The name that `name`, which names a file of Stable-Baselines3, has where that lies elsewhere."""
    found = SB3_FILE.fullmatch(name)
    return name if found is None else f"{file}{name[found.end('file') :]}"


def agent_named(name: str, task: TaskConfig) -> Agent | None:
    """The agent behind `MODULE:NAME`, `FILE.zip`, `FILE.zip:WRAPPER`, or one of the latter two with `:sampled`.

    A class is made for the task, a function is asked for each action, anything else flies as it is. Modules are found
    as Python finds them, and in the working directory. None where a name is of none of these forms.

    Raises:
        InvalidValueError: if there is no such module, or nothing of that name in it that flies.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no policy, or none for the task.
    """
    zipped, mine = SB3_FILE.fullmatch(name), MODULE.fullmatch(name)
    if zipped is not None:
        from drone_env.agents.sb3_policy import load_policy

        wrapper = zipped["wrapper"] and _wrapper(zipped["wrapper"])
        return load_policy(Path(zipped["file"]), task, wrapper, sampled=zipped["sampled"] is not None)
    return None if mine is None else as_agent(_member(mine["module"], mine["name"], f"agent {name!r}"), task)


def as_agent(policy: Any, task: TaskConfig, wrapper: Any = None, sampled: bool = False) -> Agent:
    """Anything that can fly, as an agent.

    Args:
        policy: An agent, a class of one, a function of the observation, or a model of Stable-Baselines3.
        task: What it is to fly.
        wrapper: The wrapper that a model was trained behind, or its name.
        sampled: Whether a model draws its actions; else it takes the likeliest.

    Raises:
        InvalidValueError: if it is none of these, or something is said that only a model takes.
        CheckpointError: if the model sees other observations than those of the task behind the wrapper.
    """
    if hasattr(policy, "predict") and hasattr(policy, "observation_space"):
        from drone_env.agents.sb3_policy import Sb3Agent

        chosen = _wrapper(wrapper) if isinstance(wrapper, str) else wrapper
        return Sb3Agent(task, getattr(policy, "policy", policy), chosen, sampled)
    if wrapper is not None or sampled:
        raise InvalidValueError(f"wrapper and sampled are said of a model of Stable-Baselines3, got {policy!r}")
    made = policy(task) if isinstance(policy, type) else policy
    if callable(getattr(made, "act", None)) and callable(getattr(made, "reset", None)):
        if getattr(made, "config", None) is None:
            made.config = _identity(type(made))
        return made
    if callable(made) and not isinstance(policy, type):
        return FunctionAgent(cast(Callable[[Observation], int], made), _identity(made))
    takes = "a function of the observation, an agent (reset, act), a class of one, or a model of Stable-Baselines3"
    raise InvalidValueError(f"what flies is {takes}; got {policy!r}")


def _identity(made: Any) -> dict[str, object]:
    """What decides how code flies, as far as can be told: its name, and what the file of its module holds."""
    module = sys.modules.get(made.__module__)
    file = getattr(module, "__file__", None)
    source = None if file is None else hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16]
    return {"agent": f"{made.__module__}:{getattr(made, '__qualname__', type(made).__qualname__)}", "source": source}


def _wrapper(name: str) -> Any:
    """A wrapper of this package by its name, or of any module by `MODULE:NAME`."""
    module, _, member = f"drone_env.envs.wrappers:{name}".rpartition(":") if ":" not in name else name.partition(":")
    return _member(module, member, f"wrapper {name!r}")


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
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module is there, and lacks one itself
        raise InvalidValueError(f"{what}: Python finds no module {module!r}, nor is there one in {here}") from None
