"""Your own classes and functions, and models of Stable-Baselines3, as agents."""

from collections.abc import Callable, Mapping
from typing import Any, cast

from drone_env.agents.base import Agent, named_failures
from drone_env.agents.source import identity
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError


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
            agent.config = identity(type(agent))
        return agent
    if callable(agent) and not isinstance(policy, type):
        return FunctionAgent(cast(Callable[[Observation], int], agent), identity(agent))
    allowed = "a function of the observation, an object or class with reset and act, or a model of Stable-Baselines3"
    raise InvalidValueError(f"an agent is {allowed}; got {policy!r}")
