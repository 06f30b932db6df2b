"""All that decides how a training run goes. A new hyperparameter is one more field."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, own_profile
from drone_env.core.tasks import get_task, own_rules
from drone_env.errors import InvalidValueError


@dataclass(frozen=True)
class TrainConfig:
    """One training run; `PRESETS` holds two to start from.

    Raises:
        UnknownNameError: if there is no such task or reward profile.
        InvalidValueError: if a number is out of range.
    """

    task: str = "easy"
    """The task, by its short name, id or grader."""
    episodes: int = 3_000
    """Episodes to fly in all; a resumed run goes on up to this number."""
    seed: int = 0
    """Of the weights, the maps, the exploration and the replay: equal seeds, equal runs (on a CPU)."""
    reward_profile: str = DEFAULT_PROFILE
    """What steps pay. Its shaping, if it has one, is set to `gamma`."""
    gpu: bool = False
    """Train on a CUDA device."""
    num_threads: int = 2
    """Threads that PyTorch computes with. Runs with other numbers differ in the last bits."""
    num_envs: int = 512
    """Episodes flown side by side: as many maps are in the replay from the first step on."""
    gamma: float = 0.99
    """Discount."""
    reward_scale: float = 10.0
    """What rewards are multiplied by for the network: brings the differences between actions, some hundredths of a
    score, above what its output jitters by at this learning rate."""
    n_step: int = 1
    """Steps over which rewards are summed before the network's own estimate takes over."""
    batch_size: int = 256
    """Transitions per update."""
    learning_rate: float = 5e-4
    """Of Adam, at the start."""
    final_learning_rate: float = 1e-5
    """At the last episode; it falls in a straight line."""
    replay_size: int = 200_000
    """Transitions that are kept."""
    learning_starts: int = 5_000
    """Steps before the first update."""
    steps_per_update: float = 64.0
    """Steps flown for each update."""
    double: bool = True
    """Whether the online network chooses the action that the target network values (Double DQN)."""
    advantage_learning: float = 0.9
    """By which share of its disadvantage an action is valued lower still (advantage learning): 0.9 makes the gap
    between the best action and another 1 / (1 - 0.9) times as wide, and leaves the best one's value as it is."""
    loss: Literal["huber", "mse"] = "huber"
    """What the error of an estimate costs."""
    max_grad_norm: float = 10.0
    """Gradients longer than this are shortened to it; 0 for never."""
    target_update: Literal["soft", "episodes"] = "soft"
    """Whether the target network follows a little at every update, or is copied every few episodes."""
    tau: float = 0.02
    """How much it follows, where it is `soft`."""
    target_every: int = 10
    """Every how many episodes it is copied, where it is by `episodes`."""
    exploration: Literal["linear", "multiplicative"] = "linear"
    """Whether epsilon falls in a line over steps, or by a factor per episode."""
    epsilon_start: float = 1.0
    """Share of random actions at the start."""
    epsilon_end: float = 0.5
    """And at the end."""
    epsilon_steps: int = 80_000
    """Steps over which it falls, where it is `linear`."""
    epsilon_factor: float = 0.995
    """Factor per episode, where it is `multiplicative`."""
    validation_every: int = 100
    """Episodes between two validations."""
    validation_maps: int = 500
    """Maps of the validation split that each flies."""
    log_every: int = 20
    """Episodes per line of the log."""
    checkpoint_episodes: int = 50
    """Episodes up to the first checkpoint, and at least this many between two."""
    checkpoint_seconds: float = 10.0
    """At least this many seconds between two checkpoints."""

    def __post_init__(self) -> None:
        get_task(self.task)
        get_reward_profile(self.reward_profile)
        positive = (
            "episodes", "num_threads", "num_envs", "n_step", "batch_size", "learning_rate", "replay_size",
            "reward_scale", "steps_per_update", "target_every", "epsilon_steps", "epsilon_factor", "validation_every",
            "validation_maps", "log_every",
        )  # fmt: skip
        for name in positive:
            _require(getattr(self, name) > 0, f"{name} must be above 0, got {getattr(self, name)}")
        not_below = ("final_learning_rate", "learning_starts", "max_grad_norm", "seed")
        for name in (*not_below, "checkpoint_episodes", "checkpoint_seconds"):
            _require(getattr(self, name) >= 0, f"{name} must not be below 0, got {getattr(self, name)}")
        for name in ("gamma", "tau", "advantage_learning", "epsilon_start", "epsilon_end", "epsilon_factor"):
            _require(0 <= getattr(self, name) <= 1, f"{name} must be in [0, 1], got {getattr(self, name)}")
        _require(self.advantage_learning < 1, f"advantage_learning must be below 1, got {self.advantage_learning}")
        _require(
            self.replay_size >= self.num_envs * (self.n_step + 2),
            f"replay_size {self.replay_size} does not hold {self.n_step + 2} steps of {self.num_envs} episodes",
        )

    def identity(self) -> dict[str, Any]:
        """What a resumed run must share with the one that it goes on from: all but how long and how often.

        Of a reward profile that is none of the package's, all that it holds; of such a task, the digest of its rules.
        """
        own = own_profile(self.reward_profile)
        rewards = {} if own is None else {f"reward {name}": term for name, term in own.terms().items()}
        free = ("episodes", "checkpoint_episodes", "checkpoint_seconds")
        return {name: value for name, value in asdict(self).items() if name not in free} | {
            "task": get_task(self.task).id,
            "task_version": get_task(self.task).version,
            **own_rules(get_task(self.task)),
            **rewards,
        }


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InvalidValueError(message)


ORIGINAL = TrainConfig(
    episodes=500,
    num_envs=1,
    reward_scale=1.0,
    batch_size=64,
    learning_rate=1e-4,
    final_learning_rate=1e-4,
    replay_size=10_000,
    learning_starts=64,
    steps_per_update=1,
    double=False,
    advantage_learning=0,
    max_grad_norm=0,
    target_update="episodes",
    target_every=10,
    exploration="multiplicative",
    epsilon_end=0.05,
    validation_every=50,
    log_every=1,
    checkpoint_seconds=0,
)
"""The original's hyperparameters."""

FAST: dict[str, TrainConfig] = {
    "easy_delivery": TrainConfig(episodes=4_000, validation_every=200),
    "medium_delivery": TrainConfig(episodes=1_200),
    "hard_delivery": TrainConfig(episodes=1_000),
    "skyline_easy": TrainConfig(episodes=12_000, epsilon_end=0.1, validation_every=1_000),
    "skyline_medium": TrainConfig(episodes=8_000, epsilon_end=0.1, validation_every=500),
    "skyline_hard": TrainConfig(episodes=6_000, epsilon_end=0.1, validation_every=500),
}
"""What was found to learn fastest, for each of the three delivery tasks; others take the numbers of `hard_delivery`."""

PRESETS = ("fast", "original")


def preset(name: str, task: str, episodes: int | None = None) -> TrainConfig:
    """The configuration of a preset for a task.

    Args:
        name: `fast` or `original`.
        task: The task.
        episodes: How many to fly; None for as many as the preset has. `fast` flies the fewer side by side the fewer
            there are to fly, so that the later ones can be flown by what was learned from the earlier.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if there is no such preset, or no such number of episodes.
    """
    _require(name in PRESETS, f"preset must be one of {', '.join(PRESETS)}, got {name!r}")
    known = get_task(task)
    config = replace(ORIGINAL if name == "original" else FAST.get(known.id, FAST["hard_delivery"]), task=task)
    if episodes is None:
        return config
    config, usual = replace(config, episodes=episodes), config.episodes
    if name == "original" or episodes >= usual:
        return config
    # A power of two; each place flies at least 16 of the episodes, one after the other.
    num_envs = min(1 << max((episodes // 16).bit_length() - 1, 0), config.num_envs)
    return replace(
        config,
        num_envs=num_envs,
        learning_starts=32 * num_envs,
        steps_per_update=max(known.max_steps / 4, num_envs / 2),
        epsilon_end=0.1,
        epsilon_steps=max(episodes * known.max_steps * 2 // 5, 1),
        validation_every=max(episodes // 10, 1),
    )
