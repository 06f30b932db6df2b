"""The protocols of agents."""

import traceback
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import check_action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import AgentError, DroneEnvError, InvalidValueError


class Agent(Protocol):
    """Turns observations into actions. One agent flies one episode at a time, on one task.

    A stochastic agent has `stochastic = True`: an evaluation may then fly each map several times.
    """

    @property
    def config(self) -> Mapping[str, object]:
        """The agent's configuration as JSON values: part of the identity of its results."""
        ...

    def reset(self, seed: int) -> None:
        """Forget the last episode and seed all random choices.

        The seed is that of the map, or another one if a stochastic agent flies the same map again.
        """
        ...

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4."""
        ...


@runtime_checkable
class BatchAgent(Protocol):
    """An agent that can also fly N episodes of its task together, with the same choices as for each alone.

    A stateless agent has `stateless = True`: it may get only the episodes that still fly.
    """

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last episodes and seed all random choices, int64[N], as in `reset`."""
        ...

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N], for grids uint8[N, H, W] and telemetry float32[N, telemetry_size].

        Actions for ended episodes are ignored.
        """
        ...


class StatelessAgent:
    """Base class of agents whose actions depend on the current observation alone."""

    stateless = True

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4."""
        return int(self.act_batch(observation["grid"][None], observation["telemetry"][None])[0])

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N], as `BatchAgent.act_batch`; each subclass has its own."""
        raise NotImplementedError


def begin(agent: Agent, name: str, episode: Episode, seed: int | None = None) -> Callable[[Observation], int]:
    """Reset an agent for an episode and return its `act`, whose errors name the agent and the step.

    Args:
        agent: The agent.
        name: The agent's name in errors.
        episode: The episode to fly.
        seed: The agent seed; None for the seed of the map.

    Raises:
        AgentError, InvalidValueError: as `named_failures`; so does the returned function.
    """

    def where() -> str:
        return f"map {episode.seed}, step {episode.steps + 1}"

    def act(observation: Observation) -> int:
        with named_failures(name, episode.task, where):
            return check_action(agent.act(observation))

    with named_failures(name, episode.task, lambda: f"map {episode.seed}, reset"):
        agent.reset(episode.seed if seed is None else seed)
    return act


@contextmanager
def named_failures(name: str, task: TaskConfig, where: Callable[[], str]) -> Generator[None, None, None]:
    """Name the agent, the task and the place in the errors of an agent's code inside the `with`.

    Raises:
        AgentError: from any error except those of this package.
        InvalidValueError: from one of that kind, such as an unknown action.
    """
    try:
        yield
    except InvalidValueError as error:
        raise InvalidValueError(f"agent {name!r} on {task.id!r}, {where()}: {error}") from error
    except DroneEnvError:
        raise
    except Exception as error:
        own, ours = error.__traceback__, f"{__name__.partition('.')[0]}."
        while own is not None and own.tb_frame.f_globals.get("__name__", "").startswith((ours, "contextlib")):
            own = own.tb_next
        trace = "".join(traceback.format_exception(type(error), error, own or error.__traceback__))
        message = f"agent {name!r} on {task.id!r}, {where()}: {type(error).__name__}: {error}"
        raise AgentError(message, trace) from error
