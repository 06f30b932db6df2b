"""Your own classes and functions, and models of Stable-Baselines3, as agents: `MODULE:NAME`, and their identity."""

import hashlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import Agent, StatelessAgent, named_failures
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, UnsupportedTaskError

ADDRESS = re.compile(r" at 0x[0-9a-f]+")
MODULE_AND_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
"""The form `MODULE:NAME`."""


class FunctionAgent:
    """A function of the observation as an agent; a stochastic one has a true attribute `stochastic`.

    Args:
        act: Returns an action, 0 to 4.
        config: The configuration as JSON values.
    """

    def __init__(self, act: Callable[[Observation], int], config: Mapping[str, object]) -> None:
        self.act: Any = act
        self.config = config
        self.stochastic = bool(getattr(act, "stochastic", False))

    def reset(self, seed: int) -> None:
        """Nothing to forget."""


class Sb3Agent(StatelessAgent):
    """Takes the likeliest action of a model (`predict(deterministic=True)`); a MaskablePPO gets the action mask.

    The observation space of the model decides what it gets: the plain observation or another of `envs.forms`.

    Raises:
        UnsupportedTaskError: if the task has no observation of that space.
        InvalidValueError: if the model is recurrent or takes the normalised observations of `VecNormalize`.
    """

    def __init__(self, task: TaskConfig, model: Any) -> None:
        # Imported lazily, because Gymnasium takes a while.
        from drone_env.envs import forms as of

        plain, stops = of.observation_space(task), of.StopEntries(task)
        forms: dict[str, tuple[Any, Callable[[Any], Any]]] = {
            "plain": (plain, dict),
            "planes": (of.planes_space(plain), of.to_planes),
            "flat": (of.vector_space(plain), of.to_vector),
            "stops": (stops.space, stops),
        }
        fitting = [(name, to_form) for name, (space, to_form) in forms.items() if space == model.observation_space]
        if not fitting:
            allowed = " or ".join(f"{space}" for space, _ in forms.values())
            raise UnsupportedTaskError(
                "this model was trained on another task or form of the observation: "
                f"it takes {model.observation_space}; on {task.id!r} it can be {allowed}"
            )
        ((form, self._to_form),) = fitting
        normalised = model.get_vec_normalize_env() if hasattr(model, "get_vec_normalize_env") else None
        if hasattr(model.policy, "lstm_actor") or getattr(normalised, "norm_obs", False):
            raise InvalidValueError("recurrent models and VecNormalize(norm_obs=True) need a class of your own")
        self._task, self._policy = task, model.policy
        self._masked = "maskable" in type(model.policy).__module__
        weights = hashlib.sha256()
        for key, tensor in model.policy.state_dict().items():
            weights.update(key.encode() + tensor.detach().cpu().numpy().tobytes())
        policy = f"{type(model.policy).__module__}.{type(model.policy).__qualname__}"
        self.config: Mapping[str, object] = {
            "agent": "sb3",
            "version": 2,
            "policy": policy,
            "weights": weights.hexdigest()[:16],
            "form": form,
        }

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The likeliest actions, int64[N]."""
        masks: dict[str, Any] = {}
        if self._masked:
            from drone_env.planning.nearby import action_masks, entries_of  # Imported lazily: compiling takes seconds.

            masks["action_masks"] = action_masks(entries_of(self._task, grids, telemetry))
        observations = self._to_form({"grid": grids, "telemetry": telemetry})
        return np.asarray(self._policy.predict(observations, deterministic=True, **masks)[0], np.int64)


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
        return Sb3Agent(task, policy)
    agent = policy
    if isinstance(policy, type):
        with named_failures(policy.__qualname__, task, lambda: "constructor"):
            agent = policy(task)
    if callable(getattr(agent, "act", None)) and callable(getattr(agent, "reset", None)):
        if getattr(agent, "config", None) is None:
            agent.config = identity(type(agent))
        return agent
    if callable(agent) and not isinstance(policy, type):
        return FunctionAgent(cast(Callable[[Observation], int], agent), identity(agent))
    allowed = "a function of the observation, an object or class with reset and act, or a model of Stable-Baselines3"
    raise InvalidValueError(f"an agent is {allowed}; got {policy!r}")


def imported(address: str) -> Any:
    """The member of `MODULE:NAME`. Modules are imported from Python's path or the working directory.

    Raises:
        InvalidValueError: if there is no such module, or no such member in it.
    """
    module, _, name = address.partition(":")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that installed packages have priority
    try:
        found = import_module(module)
    except (Exception, SystemExit) as error:  # importing a module runs any code
        reason = f"{type(error).__name__}: {error}"
        raise InvalidValueError(f"agent {address!r}: cannot import module {module!r}: {reason}") from error
    if not hasattr(found, name):
        raise InvalidValueError(f"agent {address!r}: {found.__file__} has no {name!r}")
    return getattr(found, name)


def identity(policy: Any) -> dict[str, object]:
    """The identity of code: its name and a digest of its module's file. A `partial` adds its arguments.

    Code without such a file, as in a REPL, is another one each time.
    """
    if isinstance(policy, partial):
        bound = cast("partial[Any]", policy)
        return {**identity(bound.func), "bound": ADDRESS.sub("", f"{bound.args} {bound.keywords}")}
    code: Any = policy if hasattr(policy, "__qualname__") else policy.__class__
    file = getattr(sys.modules.get(code.__module__), "__file__", None)
    content = Path(file).read_bytes() if file and Path(file).is_file() else uuid4().bytes
    return {"agent": f"{code.__module__}:{code.__qualname__}", "source": hashlib.sha256(content).hexdigest()[:16]}
