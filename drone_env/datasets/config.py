"""The configuration of a data set: equal configurations give equal rows."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.results.evaluate import episodes_key
from drone_env.results.result import EpisodesKey

FORMAT = "drone_env/dataset"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class DatasetConfig:
    """The maps and agents of a data set. `dataset_config` makes one.

    Attributes:
        task: The task.
        keys: One for each agent, all over the same maps.
        epsilon: The probability with which a step flies a uniformly random action instead of the agent's.
        reward_profile: The reward profile.
    """

    task: TaskConfig
    keys: tuple[EpisodesKey, ...]
    epsilon: float
    reward_profile: str

    @property
    def seeds(self) -> range:
        """The maps."""
        return range(*self.keys[0].seeds)

    @property
    def split(self) -> str:
        """The split of the maps, or `custom`."""
        return self.keys[0].split

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents, in this order on each map."""
        return tuple(key.agent for key in self.keys)

    @property
    def episodes(self) -> int:
        """The number of flights."""
        return len(self.seeds) * len(self.keys)

    @property
    def minari_id(self) -> str:
        """The name under which Minari loads the data set."""
        return f"drone_delivery_{self.task.short_name}-v{self.task.version}"

    def as_json(self) -> dict[str, Any]:
        """The whole configuration as JSON values, with its hash and the version of this package.

        The hash, 16 hex digits, changes with anything that decides what the rows hold, except the package's version.
        """
        config: dict[str, Any] = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "task": self.task.rules(),
            "split": self.split,
            "seeds": [self.seeds.start, self.seeds.stop],
            "agents": [
                {"config_hash": key.config_hash, **make_agent(key.agent, self.task).config} for key in self.keys
            ],
            "epsilon": self.epsilon,
            "reward_profile": asdict(get_reward_profile(self.reward_profile)),
        }
        config = json.loads(json.dumps(config, default=str))
        digest = hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()[:16]
        return {**config, "config_hash": digest, "package_version": __version__}


def dataset_config(
    task: str | TaskConfig,
    seeds: range,
    split: str = "custom",
    agents: Sequence[str] = ("optimal", "greedy", "random"),
    epsilon: float = 0.1,
    reward_profile: str = DEFAULT_PROFILE,
) -> DatasetConfig:
    """The configuration of a data set.

    Raises:
        UnknownNameError: if there is no such task, split, agent or reward profile.
        InvalidValueError: if there are no seeds, they are out of range or not of the split, there is no agent or one
            twice, or epsilon is not in [0, 1].
    """
    task = get_task(task)
    if not agents or len(set(agents)) < len(agents):
        raise InvalidValueError(f"agents must be one name or more, each once; got {list(agents)}")
    if not 0 <= epsilon <= 1:
        raise InvalidValueError(f"epsilon must be a probability, 0 to 1; got {epsilon!r}")
    profile = get_reward_profile(reward_profile)
    keys = tuple(episodes_key(task, agent, seeds, split) for agent in agents)
    return DatasetConfig(task, keys, float(epsilon), profile.id)
