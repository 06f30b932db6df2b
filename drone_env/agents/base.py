"""The protocols of agents, and flights by them: one at a time, or many in parallel."""

import traceback
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import check_action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import AgentError, DroneEnvError, InvalidValueError

ActBatch = Callable[[npt.NDArray[np.uint8], npt.NDArray[np.float32]], npt.NDArray[np.int64]]
"""From grids uint8[N, H, W] and telemetry float32[N, telemetry_size] to actions, int64[N]."""


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


class BatchResults(NamedTuple):
    """The results of n episodes, in the order of their seeds."""

    scores: npt.NDArray[np.float64]
    """float64[n], graded."""
    steps: npt.NDArray[np.int32]
    """int32[n], steps flown."""
    deliveries_done: npt.NDArray[np.int32]
    """int32[n], parcels delivered."""


def rollout_batch(
    task: TaskConfig,
    seeds: npt.NDArray[np.int64],
    act: ActBatch,
    stateless: bool,
    name: str = "network",
    reset: Callable[[], None] = lambda: None,
) -> BatchResults:
    """Fly each map once.

    Args:
        task: The task.
        seeds: int64[n], the maps.
        act: Returns the actions.
        stateless: Whether `act` keeps no state per episode; it then gets only episodes that still fly.
        name: The agent's name in errors.
        reset: Called before the first step.
    """
    from drone_env.core.batch import Batch  # Imported lazily: compiling takes seconds.

    n, step = len(seeds), 0
    results = BatchResults(np.zeros(n), np.zeros(n, np.int32), np.zeros(n, np.int32))
    flying, actions = np.ones(n, np.bool_), np.zeros(n, np.int64)
    with named_failures(name, task, lambda: f"maps {seeds[0]} to {seeds[-1]}, step {step}"):
        reset()
        batch = Batch(task, n)
        batch.reset(seeds)
        while flying.any():
            step += 1
            active = flying if stateless else slice(None)
            actions[active] = act(batch.grids[active], batch.telemetry[active])
            batch.step(actions)
            # Ended episodes are reset to other maps: only the first end counts.
            first = flying[batch.ended]
            ended, finals = batch.ended[first], batch.finals()
            for column, figure in zip(results, ("score", "steps", "deliveries"), strict=True):
                column[ended] = finals[figure][first]
            flying[ended] = False
    return results
