"""The configuration of a dataset, and its flights with the exact values of every state that they reach."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.episode import Episode, choices
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.llm.prompt import get_prompt, ways_of
from drone_env.planning.optimal import solver_of
from drone_env.planning.solver import Solver
from drone_env.planning.stops import stop_values
from drone_env.results.evaluate import episodes_key

FORMAT = "drone_env/dataset"


@dataclass(frozen=True)
class DatasetConfig:
    """Everything that determines the rows of a dataset: equal configurations give equal rows.

    Attributes:
        task: The task.
        seeds: The maps.
        split: The split that the maps belong to, or `custom`.
        agents: The agents, in this order on each map.
        epsilon: Probability that a step takes a uniformly random action instead of the agent's; if the prompt asks for
            stops, that a random stop is flown.
        reward_profile: The reward profile.
        prompt: The prompt of conversations; None to write none.
        minari: Whether to write the flights as a Minari dataset, too.

    Raises:
        UnknownNameError: if there is no such split, agent, reward profile or prompt.
        InvalidValueError: if the seeds are empty, out of range or outside the split, the agents are empty or repeated,
            epsilon is not in [0, 1], or Minari does not run on this Python.
    """

    task: TaskConfig
    seeds: range
    split: str = "custom"
    agents: Sequence[str] = ("optimal", "greedy", "random")
    epsilon: float = 0.1
    reward_profile: str = DEFAULT_PROFILE
    prompt: str | None = None
    minari: bool = False

    def __post_init__(self) -> None:
        if not self.agents or len(set(self.agents)) < len(self.agents):
            raise InvalidValueError(f"agents must be one name or more, each once; got {list(self.agents)}")
        if not 0 <= self.epsilon <= 1:
            raise InvalidValueError(f"epsilon must be a probability, 0 to 1; got {self.epsilon!r}")
        if self.minari and sys.version_info < (3, 11):
            raise InvalidValueError("a Minari dataset needs Python 3.11 or newer")
        if self.asks_for_stops and list(self.agents) != ["optimal"]:
            raise InvalidValueError(f"agents must be optimal alone: no other chooses the stops of prompt {self.prompt}")
        self.as_json()  # raises if another value is invalid

    @property
    def asks_for_stops(self) -> bool:
        """Whether the flights are by stops, because the prompt asks for them."""
        return self.prompt is not None and get_prompt(self.prompt).stop

    @property
    def episodes(self) -> int:
        """The number of flights."""
        return len(self.seeds) * len(self.agents)

    @property
    def minari_id(self) -> str:
        """The id of the dataset in Minari."""
        return f"drone_delivery_{self.task.short_name}-v{self.task.version}"

    def as_json(self) -> dict[str, Any]:
        """Return the configuration as JSON values, with the version of this package."""
        made = {name: make_agent(name, self.task) for name in self.agents}
        keys = [episodes_key(self.task, name, self.seeds, self.split, made=agent) for name, agent in made.items()]
        config = {
            "format": FORMAT,
            "format_version": 1,
            "task": self.task.rules(),
            "split": self.split,
            "seeds": [self.seeds.start, self.seeds.stop],
            "agents": [{"config_hash": key.config_hash, **made[key.agent].config} for key in keys],
            "epsilon": float(self.epsilon),
            "reward_profile": asdict(get_reward_profile(self.reward_profile)),
            "task_digest": self.task.digest,
            "package_version": __version__,
        }
        if self.prompt is not None:
            prompt = get_prompt(self.prompt)
            config |= {"prompt": prompt.id, "prompt_digest": prompt.digest}
        return json.loads(json.dumps(config, default=str))


class Trajectory(NamedTuple):
    """One flight of T steps.

    Attributes:
        number: The number of the flight in the dataset, from 0.
        seed: The map.
        agent: The name of the agent.
        score: Its graded score.
        optimal_score: The highest score that any flight over the map gets.
        steps: Arrays [T, ...]. Before each step: `grid`, `telemetry`, `action_mask`, `value`, the highest score that
            can still be reached, and `q_values`, that after each action. Of the step: `action`, `agent_action` before
            random actions replace some, `reward`, `event` (`Event`), `regret`, `optimal_actions`, and the `score` after
            it and whether it `terminated` the flight.
        end: `grid`, `telemetry` and `action_mask` of the last state, after which nothing is flown.
        stops: Of a flight by stops: for each, the number of earlier steps, and the `stop_values`.
    """

    number: int
    seed: int
    agent: str
    score: float
    optimal_score: float
    steps: dict[str, npt.NDArray[Any]]
    end: dict[str, Any]
    stops: Sequence[tuple[int, dict[str, float]]] = ()


def fly_map(config: DatasetConfig, seed: int) -> Iterator[Trajectory]:
    """Fly all agents over one map, which is solved once.

    Raises:
        TooLargeError: if the exact values of the map would take too much memory.
        AgentError, InvalidValueError: if an agent fails, or returns an invalid action.
    """
    start = Episode(config.task, config.reward_profile, seed)
    solver = solver_of(start)
    first = (seed - config.seeds.start) * len(config.agents)
    for number, name in enumerate(config.agents, first):
        fly = _fly_stops if config.asks_for_stops else _fly
        yield fly(number, start.copy(), solver, name, config.epsilon)


def random_actions(agent: str, seed: int) -> Iterator[tuple[float, int]]:
    """Yield a number in [0, 1) and an action for each step; the action is taken if the number is below epsilon.

    They depend on the agent's name and the map only, so a flight does not change with the other agents or maps.
    """
    key = map_key(task_key(f"dataset/chance/{agent}", 1), seed)
    while True:
        key = next_key(key)
        share = uniform_below(key, 1 << 32) / (1 << 32)
        key = next_key(key)
        yield share, uniform_below(key, N_ACTIONS)


def _fly(number: int, episode: Episode, solver: Solver, name: str, epsilon: float) -> Trajectory:
    act = begin(make_agent(name, episode.task), name, episode)
    actions = (
        (int(choice), action if share < epsilon else int(choice))
        for choice, (share, action) in zip(choices(episode, act), random_actions(name, episode.seed), strict=False)
    )
    return _recorded(number, episode, solver, name, actions)


def _fly_stops(number: int, episode: Episode, solver: Solver, name: str, epsilon: float) -> Trajectory:
    """A flight by stops: the best one, or with probability epsilon a random one. After the last it waits."""
    requests = list[tuple[int, dict[str, float]]]()

    def actions() -> Iterator[tuple[int, int]]:
        for share, _ in random_actions(name, episode.seed):
            ways, values = ways_of(episode), stop_values(episode)
            if not values:
                break
            requests.append((episode.steps, values))
            label = max(values, key=values.__getitem__)
            if share < epsilon:  # then share / epsilon is uniform in [0, 1)
                label = list(values)[int(share / epsilon * len(values))]
            yield from ((action, action) for action in ways[label])
        while not episode.ended:
            yield Action.WAIT, Action.WAIT

    return _recorded(number, episode, solver, name, actions())._replace(stops=requests)


def _recorded(
    number: int, episode: Episode, solver: Solver, name: str, actions: Iterable[tuple[int, int]]
) -> Trajectory:
    """Fly actions, each with the agent's, and record every step."""
    rows = list[dict[str, Any]]()
    for choice, action in actions:
        row = _state(episode) | {"q_values": solver.q_values(episode), "agent_action": int(choice)}
        row["action"] = int(action)
        row["reward"] = episode.step(row["action"])
        rows.append({**row, "event": int(episode.event), "score": episode.score, "terminated": episode.ended})
    steps = {column: np.array([row[column] for row in rows]) for column in rows[0]}
    q_values = steps["q_values"]
    values = q_values.max(axis=1)
    steps |= {
        "value": values,
        "regret": values - q_values[np.arange(len(rows)), steps["action"]],
        "optimal_actions": q_values == values[:, None],
    }
    return Trajectory(number, episode.seed, name, episode.score, float(values[0]), steps, _state(episode))


def _state(episode: Episode) -> dict[str, Any]:
    return {**episode.observation(), "action_mask": episode.action_mask()}
