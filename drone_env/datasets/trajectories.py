"""Trajectories: flights with the exact values of every state that they reach."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.core.actions import N_ACTIONS
from drone_env.core.episode import Episode, choices
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.datasets.config import DatasetConfig
from drone_env.planning.optimal import solver_of
from drone_env.planning.solver import Solver


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One whole flight: T steps, T + 1 states.

    Attributes:
        number: The number of the flight in the data set, from 0.
        seed: The map.
        agent: The name of the agent.
        grids: uint8[T + 1, H, W] of cell ids.
        telemetry: float32[T + 1, telemetry_size].
        action_masks: int8[T + 1, 5], 0 for each action that would bump.
        scores: float64[T + 1], the graded score as it stands.
        events: int8[T + 1], the event before the state (`Event`).
        actions: int8[T], the flown actions.
        agent_actions: int8[T], the agent's choices.
        rewards: float64[T].
        values: float64[T + 1], V*: the highest score that can still be reached; at the end the score.
        q_values: float64[T, 5], Q*: the highest score that can still be reached after each action.
    """

    number: int
    seed: int
    agent: str
    grids: npt.NDArray[np.uint8]
    telemetry: npt.NDArray[np.float32]
    action_masks: npt.NDArray[np.int8]
    scores: npt.NDArray[np.float64]
    events: npt.NDArray[np.int8]
    actions: npt.NDArray[np.int8]
    agent_actions: npt.NDArray[np.int8]
    rewards: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]
    q_values: npt.NDArray[np.float64]

    @property
    def steps(self) -> int:
        """T."""
        return len(self.actions)

    @property
    def terminated(self) -> npt.NDArray[np.bool_]:
        """bool[T]: whether the step ended the flight."""
        return np.arange(1, self.steps + 1) == self.steps

    @property
    def regrets(self) -> npt.NDArray[np.float64]:
        """float64[T]: V*(s) - Q*(s, a) of the flown actions, in score."""
        return self.values[:-1] - self.q_values[np.arange(self.steps), self.actions]

    @property
    def optimal_actions(self) -> npt.NDArray[np.bool_]:
        """bool[T, 5]: the actions after which the highest score can still be reached."""
        return self.q_values == self.values[:-1, None]

    @property
    def returns_to_go(self) -> npt.NDArray[np.float64]:
        """float64[T]: the undiscounted sum of the rewards from this step to the end."""
        return np.cumsum(self.rewards[::-1])[::-1]


def fly_map(config: DatasetConfig, seed: int) -> Iterator[Trajectory]:
    """The flights of all agents over one map, which is solved once.

    Raises:
        TooLargeError: if the exact values of the map would take too much memory.
        AgentError, InvalidValueError: if an agent fails, or names an action that there is not.
    """
    start = Episode(config.task, config.reward_profile, seed)
    solver = solver_of(start)
    first = (seed - config.seeds.start) * len(config.agents)
    for number, name in enumerate(config.agents, first):
        yield _fly(number, start.copy(), solver, name, config.epsilon)


def chance(agent: str, seed: int) -> Iterator[tuple[float, int]]:
    """For each step a number in [0, 1) and an action: the action is flown where the number is below epsilon.

    They depend on the agent's name and the map alone, so a flight does not change with the other agents or maps.
    """
    key = map_key(task_key(f"dataset/chance/{agent}", 1), seed)
    while True:
        key = next_key(key)
        share = uniform_below(key, 1 << 32) / (1 << 32)
        key = next_key(key)
        yield share, uniform_below(key, N_ACTIONS)


def _fly(number: int, episode: Episode, solver: Solver, name: str, epsilon: float) -> Trajectory:
    act = begin(make_agent(name, episode.task), name, episode)
    states, q_values, agent_actions = [_state(episode)], list[npt.NDArray[np.float64]](), list[int]()
    for choice, (share, action) in zip(choices(episode, act), chance(name, episode.seed), strict=False):
        q_values.append(solver.q_values(episode))
        agent_actions.append(int(choice))
        episode.step(action if share < epsilon else choice)
        states.append(_state(episode))
    grids, telemetry, action_masks, scores, events = map(np.array, zip(*states, strict=True))
    return Trajectory(
        number=number,
        seed=episode.seed,
        agent=name,
        grids=grids,
        telemetry=telemetry,
        action_masks=action_masks,
        scores=scores,
        events=events.astype(np.int8),
        actions=np.array(episode.actions, np.int8),
        agent_actions=np.array(agent_actions, np.int8),
        rewards=np.array(episode.rewards),
        values=np.append(np.max(q_values, axis=1), episode.score),
        q_values=np.array(q_values),
    )


def _state(episode: Episode) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32], npt.NDArray[np.int8], float, int]:
    """The stored part of a state: grid, telemetry, action mask, score and event."""
    obs = episode.observation()
    return obs["grid"], obs["telemetry"], episode.action_mask(), episode.score, episode.event
