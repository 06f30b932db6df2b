"""The one protocol of everything that flies."""

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

    One that draws lots says so by `stochastic = True`: an evaluation may then fly each map several times.
    """

    @property
    def config(self) -> Mapping[str, object]:
        """All that decides how the agent flies, as JSON values: part of the identity of its results."""
        ...

    def reset(self, seed: int) -> None:
        """Forget the last episode; `seed` is the source of any random choice.

        It is the number of the map, or, where a stochastic agent flies the same map again, another one.
        """
        ...

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4."""
        ...


@runtime_checkable
class BatchAgent(Protocol):
    """An agent that can also fly N episodes of its task together, and then chooses as it would for each alone.

    One that holds no state for each episode says so by `stateless = True`: it may be shown those alone that still fly.
    """

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last episodes; `seeds`, int64[N], are the sources of their random choices, as in `reset`."""
        ...

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N], for grids uint8[N, H, W] and telemetry float32[N, telemetry_size].

        What it chooses for an episode that has ended is not used.
        """
        ...


def begin(agent: Agent, name: str, episode: Episode, seed: int | None = None) -> Callable[[Observation], int]:
    """Reset an agent for an episode, and hand out what names its actions: its `act`, whose errors say where it failed.

    Args:
        agent: The agent.
        name: What an error calls it.
        episode: What it is to fly.
        seed: The source of its random choices; None for the number of the map.

    Raises:
        AgentError, InvalidValueError: as `named_failures`; so does what is handed out.
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
    """Where the code of an agent fails inside of the `with`, the error says whose, on which task, and where.

    Raises:
        AgentError: from any error but those of this package.
        InvalidValueError: from one of that kind, such as an action that there is not.
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
        told = f"agent {name!r} on {task.id!r}, {where()}: {type(error).__name__}: {error}"
        raise AgentError(told, trace) from error
