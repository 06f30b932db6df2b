"""The configuration of a data set: equal configurations give equal rows."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.results.evaluate import episodes_key

FORMAT = "drone_env/dataset"


@dataclass(frozen=True)
class DatasetConfig:
    """What decides the rows of a data set.

    Attributes:
        task: The task.
        seeds: The maps.
        split: The split that they were chosen from, or `custom`.
        agents: The agents, in this order on each map.
        epsilon: The probability with which a step flies a uniformly random action instead of the agent's.
        reward_profile: The reward profile.

    Raises:
        UnknownNameError: if there is no such split, agent or reward profile.
        InvalidValueError: if there are no seeds, they are out of range or not of the split, there is no agent or one
            twice, or epsilon is not in [0, 1].
    """

    task: TaskConfig
    seeds: range
    split: str = "custom"
    agents: Sequence[str] = ("optimal", "greedy", "random")
    epsilon: float = 0.1
    reward_profile: str = DEFAULT_PROFILE

    def __post_init__(self) -> None:
        if not self.agents or len(set(self.agents)) < len(self.agents):
            raise InvalidValueError(f"agents must be one name or more, each once; got {list(self.agents)}")
        if not 0 <= self.epsilon <= 1:
            raise InvalidValueError(f"epsilon must be a probability, 0 to 1; got {self.epsilon!r}")
        self.as_json()  # which refuses the rest

    @property
    def episodes(self) -> int:
        """The number of flights."""
        return len(self.seeds) * len(self.agents)

    @property
    def minari_id(self) -> str:
        """The name under which Minari loads the data set."""
        return f"drone_delivery_{self.task.short_name}-v{self.task.version}"

    def as_json(self) -> dict[str, Any]:
        """The whole configuration as JSON values, with its hash and the version of this package.

        The hash, 16 hex digits, changes with anything that decides what the rows hold, except the package's version.
        """
        made = {name: make_agent(name, self.task) for name in self.agents}
        keys = [episodes_key(self.task, name, self.seeds, self.split, made=agent) for name, agent in made.items()]
        config: dict[str, Any] = {
            "format": FORMAT,
            "format_version": 1,
            "task": self.task.rules(),
            "split": self.split,
            "seeds": [self.seeds.start, self.seeds.stop],
            "agents": [{"config_hash": key.config_hash, **made[key.agent].config} for key in keys],
            "epsilon": float(self.epsilon),
            "reward_profile": asdict(get_reward_profile(self.reward_profile)),
        }
        config = json.loads(json.dumps(config, default=str))
        digest = hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()[:16]
        return {**config, "config_hash": digest, "package_version": __version__}
