"""The settings of trainings, their presets, and the tasks that the tour network trains on.

A new hyperparameter is one more field.
"""

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, get_origin, get_type_hints

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    TypeAdapter,
    ValidationError,
)

from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, own_profile
from drone_env.core.tasks import TASKS, TaskConfig, custom_task_rules, get_task
from drone_env.errors import InvalidValueError

Share = Annotated[float, Field(ge=0, le=1)]
ShareBelowOne = Annotated[float, Field(ge=0, lt=1)]


@cache
def _adapters(settings: type) -> dict[str, TypeAdapter[Any]]:
    hints: dict[str, Any] = get_type_hints(settings, include_extras=True)
    strict = ConfigDict(strict=True, allow_inf_nan=False)
    return {name: TypeAdapter(hint, config=strict) for name, hint in hints.items() if get_origin(hint) is not ClassVar}


def check_values(settings: object) -> None:
    """Check every value of a dataclass against its annotation."""
    for name in _adapters(type(settings)):
        check_value(type(settings), name, getattr(settings, name))


def check_value(settings: type, name: str, value: object) -> None:
    """Check the value of one field, if the dataclass has it, against its annotation."""
    adapter = _adapters(settings).get(name)
    try:
        _ = adapter and adapter.validate_python(value)
    except ValidationError as error:
        reason = error.errors()[0]["msg"].replace("Input", name)
        raise InvalidValueError(f"{reason}, got {value!r}") from None


@dataclass(frozen=True)
class OneTaskConfig:
    """The settings that trainings on one task share.

    Raises:
        UnknownNameError: if there is no such task or reward profile.
        InvalidValueError: if a value is out of range.
    """

    prefix: ClassVar[str] = ""
    """What the names of the training's files begin with."""
    unsaved: ClassVar[tuple[str, ...]]
    """Fields that may change when a training resumes."""

    task: str = "easy"
    """The task, by its short name, id or grader."""
    reward_profile: str = DEFAULT_PROFILE
    """Reward profile. Potential-based shaping, if the profile has it, uses `gamma`."""
    num_threads: PositiveInt = 1
    """Number of PyTorch threads. It changes the last bits of a run. Two take ten times the CPU time of one if other
    programs use the processor."""
    gamma: Share = 0.99
    """Discount factor."""
    checkpoint_seconds: NonNegativeFloat = 10.0
    """Minimum time between two checkpoints in seconds."""

    def __post_init__(self) -> None:
        check_values(self)
        get_task(self.task)
        get_reward_profile(self.reward_profile)

    @property
    def name(self) -> str:
        """The name of the training's files."""
        return self.prefix + get_task(self.task).short_name

    def identity(self) -> dict[str, Any]:
        """The settings that a resumed run shares with its checkpoint, task and reward profile in full."""
        task, own = get_task(self.task), own_profile(self.reward_profile)
        rewards = {} if own is None else {f"reward {own.id}": own.digest}
        return {name: value for name, value in asdict(self).items() if name not in self.unsaved} | {
            "task": task.id,
            "task_version": task.version,
            **custom_task_rules(task),
            **rewards,
        }


@dataclass(frozen=True)
class TrainConfig(OneTaskConfig):
    """The settings of one DQN training; `preset` makes one to start from."""

    algorithm: ClassVar[str] = "dqn"
    unit: ClassVar[str] = "episodes"
    """The field that sets the length of a training."""
    unsaved = ("episodes", "checkpoint_episodes", "checkpoint_seconds")

    episodes: PositiveInt = 3_000
    """Number of episodes, those before a resume included."""
    seed: NonNegativeInt = 0
    """Seed of the weights, maps, exploration and replay: equal seeds give equal runs on a CPU."""
    gpu: bool = False
    """Train on a CUDA device."""
    num_envs: PositiveInt = 512
    """Number of parallel environments."""
    reward_scale: PositiveFloat = 10.0
    """Factor on the rewards that the network learns. Q-values differ by some hundredths of a score between actions;
    the factor lifts these differences above the noise of the output at this learning rate."""
    batch_size: PositiveInt = 256
    """Transitions per update."""
    learning_rate: PositiveFloat = 5e-4
    """Learning rate of Adam at the start."""
    final_learning_rate: NonNegativeFloat = 1e-5
    """Learning rate at the last episode; the decay is linear."""
    replay_size: PositiveInt = 200_000
    """Capacity of the replay buffer in transitions."""
    learning_starts: NonNegativeInt = 5_000
    """Steps before the first update."""
    steps_per_update: PositiveFloat = 64.0
    """Environment steps per update."""
    double: bool = True
    """Whether the online network chooses the action that the target network values (Double DQN)."""
    advantage_learning: ShareBelowOne = 0.9
    """Weight of advantage learning, which widens the gap between the best action and the others: 0.9 makes it
    1 / (1 - 0.9) times as wide and keeps the value of the best action."""
    max_grad_norm: NonNegativeFloat = 10.0
    """Maximum norm of the gradient; 0 for no clipping."""
    target_update: Literal["soft", "episodes"] = "soft"
    """Update the target network a little at every update, or copy it every few episodes."""
    tau: Share = 0.02
    """Weight of the online network in a soft update."""
    target_every: PositiveInt = 10
    """Episodes between two copies, if `target_update` is `episodes`."""
    exploration: Literal["linear", "multiplicative"] = "linear"
    """Decay of epsilon: linear over steps, or a factor per episode."""
    epsilon_start: Share = 1.0
    """Probability of a random action at the start."""
    epsilon_end: Share = 0.5
    """Probability of a random action at the end."""
    epsilon_steps: PositiveInt = 80_000
    """Steps of the linear decay."""
    epsilon_factor: Annotated[float, Field(gt=0, le=1)] = 0.995
    """Factor per episode of the multiplicative decay."""
    validation_every: PositiveInt = 100
    """Episodes between two validations."""
    validation_maps: PositiveInt = 500
    """Number of validation maps."""
    log_every: PositiveInt = 20
    """Episodes per line of the log."""
    checkpoint_episodes: NonNegativeInt = 50
    """Minimum number of episodes before the first checkpoint and between two."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.replay_size < self.num_envs * 3:
            raise InvalidValueError(f"replay_size {self.replay_size} does not hold 3 steps of {self.num_envs} episodes")


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
"""Settings tuned for learning speed; other tasks use those of `hard_delivery`."""


def preset(name: Literal["fast", "original"], task: str, episodes: int | None = None) -> TrainConfig:
    """The settings of a preset for a task.

    Args:
        name: `fast` or `original`.
        task: The task.
        episodes: Number of episodes; None for the preset's own. With fewer episodes, `fast` flies fewer in parallel,
            so that later episodes use what earlier ones taught.
    """
    known = get_task(task)
    config = replace(ORIGINAL if name == "original" else FAST.get(known.id, FAST["hard_delivery"]), task=task)
    if episodes is None:
        return config
    config, usual = replace(config, episodes=episodes), config.episodes
    if name == "original" or episodes >= usual:
        return config
    # A power of two that leaves at least 16 episodes to each environment.
    num_envs = min(1 << max((episodes // 16).bit_length() - 1, 0), config.num_envs)
    return replace(
        config,
        num_envs=num_envs,
        learning_starts=min(32, known.max_steps) * num_envs,
        steps_per_update=max(known.max_steps / 4, num_envs / 2),
        epsilon_end=0.1,
        epsilon_steps=max(episodes * known.max_steps * 2 // 5, 1),
        validation_every=max(episodes // 10, 1),
    )


# PPO


@dataclass(frozen=True)
class PpoConfig(OneTaskConfig):
    """The settings of one PPO training; `ppo_preset` makes one to start from."""

    algorithm: ClassVar[str] = "ppo"
    unit: ClassVar[str] = "steps"
    """The field that sets the length of a training."""
    prefix = "ppo_"
    unsaved = ("steps", "checkpoint_seconds")
    checkpoint_episodes: ClassVar[int] = 1
    """Minimum number of steps between two checkpoints."""

    steps: PositiveInt = 500_000
    """Number of environment steps. Learning rate and entropy bonus fall to 0 over them."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the weights, maps, actions and batches: equal seeds give equal runs on a CPU."""
    num_envs: PositiveInt = 256
    """Number of parallel environments."""
    num_steps: PositiveInt = 32
    """Steps of each environment between two rounds of updates."""
    update_epochs: PositiveInt = 4
    """Number of times that a round learns from each step."""
    minibatch_size: Annotated[int, Field(ge=2)] = 2_048
    """Steps per update."""
    shield: bool = False
    """Choose only from first actions of the cheapest paths to stops from which a pad stays in range, if there are any.
    Else PPO may end near the rule `greedy`, because it rarely finds out what a charge is worth."""
    rush: bool = False
    """For tasks with too few steps: the network sees how many parcels nearest neighbour delivers from each stop, and
    waits that charge nothing are masked. Else PPO ends with flights that never charge."""
    hidden: PositiveInt = 128
    """Units of each hidden layer."""
    gae_lambda: Share = 0.95
    """Decay of generalised advantage estimation."""
    clip: PositiveFloat = 0.2
    """Largest change of an action's probability, relative to 1, that an update gains from."""
    entropy_weight: NonNegativeFloat = 0.03
    """Weight of the entropy bonus at the start."""
    value_weight: NonNegativeFloat = 0.5
    """Weight of the loss of the values."""
    reward_scale: PositiveFloat = 5.0
    """Factor on the rewards that the network learns."""
    learning_rate: PositiveFloat = 1e-3
    """Learning rate of Adam at the start."""
    max_grad_norm: PositiveFloat = 0.5
    """Maximum norm of the gradient."""
    average: ShareBelowOne = 0.99
    """Decay of the moving average of the weights, which is the network that flies."""
    validation_every: PositiveInt = 100_000
    """Steps between two validations."""
    validation_maps: PositiveInt = 200
    """Number of validation maps."""
    log_every: PositiveInt = 50_000
    """Steps per line of the log."""


PPO_STEPS = {
    "easy_delivery": 150_000,
    "medium_delivery": 150_000,
    "hard_delivery": 200_000,
    "skyline_easy": 2_000_000,
}
"""Number of steps of PPO by task; other tasks take a million, those of rush two."""


def ppo_preset(task: str) -> PpoConfig:
    """The settings of PPO for a task."""
    known = get_task(task)
    rush, hidden = known.family == "rush", 128 if known.pads else 64
    steps = PPO_STEPS.get(known.id, 2_000_000 if rush else 1_000_000)
    shield = known.pads > 0 and not rush and known.id != "skyline_easy"  # on which PPO ends higher without it
    return PpoConfig(task=task, steps=steps, hidden=hidden, shield=shield, rush=rush)


# The tour network

ALL = "all"
SHARES = {
    "easy_delivery": 0.0,  # one parcel, one path: nothing to choose
    "medium_delivery": 0.05,
    "hard_delivery": 0.08,
    "skyline_easy": 0.12,
    "skyline_medium": 0.16,
    "skyline_hard": 0.30,
    "rush_easy": 0.04,
    "rush_medium": 0.06,
    "rush_hard": 0.06,
}
"""Share of the samples from each task in a training on all tasks; the rest goes to `VARIANTS`."""
VARIANTS = (
    ("skyline_easy", 2, 4),
    ("skyline_easy", 4, 3),
    ("skyline_medium", 3, 6),
    ("skyline_medium", 5, 5),
    ("skyline_hard", 3, 6),
    ("skyline_hard", 4, 4),
)
"""Tasks with other numbers of parcels and pads."""
LARGEST_SIDE, FEW = 48, 4
"""Maximum side and number of parcels of an enlarged map: exact values of more take seconds."""


@dataclass(frozen=True)
class TourConfig:
    """The settings of one training of a tour network."""

    algorithm: ClassVar[str] = "tournet"
    unit: ClassVar[str] = "updates"
    """The field that sets the length of a training."""
    checkpoint_episodes: ClassVar[int] = 1
    """Minimum number of updates between two checkpoints."""

    task: str = ALL
    """The task, by its short name, id or grader; `all` for one network on all tasks and their variants."""
    updates: PositiveInt = 8_000
    """Number of updates, and length of the learning rate's decay."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the weights, maps and batches: equal seeds give equal runs on a CPU."""
    num_threads: PositiveInt = 1
    """Number of PyTorch threads, beside one that generates samples. It changes the last bits of a run."""
    batch_size: Annotated[int, Field(gt=0, multiple_of=4)] = 512
    """States per update, all of one task: a quarter from each of four chunks."""
    learning_rate: PositiveFloat = 1e-3
    """Maximum learning rate of AdamW."""
    final_learning_rate: NonNegativeFloat = 1e-5
    """Learning rate at the last update, after a cosine decay."""
    warm_up: NonNegativeInt = 200
    """Updates of linear warm-up."""
    weight_decay: NonNegativeFloat = 1e-4
    """Weight decay of AdamW."""
    max_grad_norm: PositiveFloat = 1.0
    """Maximum norm of the gradient."""
    temperature: PositiveFloat = 0.004
    """Regret, in score, at which the target probability of an option is 1 / e of the best one's."""
    regret_weight: NonNegativeFloat = 100.0
    """Weight of the expected regret in the loss."""
    completion_weight: NonNegativeFloat = 2.0
    """Weight of the completion loss."""
    average: ShareBelowOne = 0.998
    """Decay of the moving average of the weights, which is the network that flies."""
    maps_per_chunk: PositiveInt = 8
    """Maps in a chunk of samples; each update generates one chunk."""
    states_per_map: PositiveInt = 128
    """States sampled from each map."""
    randomised: Share = 0.6
    """Probability that a chunk comes from a task with other numbers (`randomise`)."""
    window: PositiveInt = 24
    """Number of latest chunks of each task that batches come from."""
    validation_every: PositiveInt = 1_000
    """Updates between two validations."""
    validation_maps: PositiveInt = 200
    """Number of validation maps of each task."""
    log_every: PositiveInt = 100
    """Updates per line of the log."""
    checkpoint_seconds: NonNegativeFloat = 30.0
    """Minimum time between two checkpoints in seconds."""

    def __post_init__(self) -> None:
        check_values(self)
        if self.task != ALL:
            task = get_task(self.task)
            if task.uniform and task.deliveries == 1:
                raise InvalidValueError(f"there is nothing to choose on {task.id!r}: one parcel, one path")

    @property
    def name(self) -> str:
        """The name of the training's files."""
        return "tournet" if self.task == ALL else f"tournet_{get_task(self.task).short_name}"

    def tasks(self) -> list[TaskConfig]:
        """The tasks that the network learns and is validated on."""
        return list(map(get_task, SHARES)) if self.task == ALL else [get_task(self.task)]

    def sampled_tasks(self) -> dict[TaskConfig, float]:
        """The tasks that samples come from, with the share of each."""
        if self.task != ALL:
            return {get_task(self.task): 1.0}
        shares = {get_task(name): share for name, share in SHARES.items() if share}
        rest = 1 - sum(shares.values())
        return shares | {variant(*of): rest / len(VARIANTS) for of in VARIANTS}

    def identity(self) -> dict[str, Any]:
        """The settings that a resumed run shares with its checkpoint, tasks in full."""
        return {name: value for name, value in asdict(self).items() if name != "checkpoint_seconds"} | {
            "task": ALL if self.task == ALL else get_task(self.task).id,
            "tasks": {task.id: task.version for task in self.tasks()},
            **custom_task_rules(*self.tasks()),
        }


def variant(name: str, deliveries: int, pads: int) -> TaskConfig:
    """An unregistered task with other numbers of parcels and pads."""
    task = TASKS[name]
    changed = f"{task.id}_{deliveries}_{pads}"
    return replace(task, id=changed, short_name=changed, grader="", deliveries=deliveries, pads=pads)


def randomise(task: TaskConfig, random: np.random.Generator) -> TaskConfig:
    """The task with other numbers: each changes with probability 1/2, and one map in three is larger."""

    def scaled(number: int, low: float, high: float) -> int:
        factor = math.exp(random.uniform(math.log(low), math.log(high)))
        return max(1, round(number * factor)) if random.random() < 0.5 else number

    if task.street_spacing and random.random() < 1 / 3:
        task = enlarge(task, int(random.choice(np.arange(task.width, LARGEST_SIDE + 1, task.street_spacing))))
    numbers = {
        "battery_capacity": scaled(task.battery_capacity, 0.6, 1.6),
        "max_steps": scaled(task.max_steps, 0.3, 2.2),
    }
    if task.pads and task.charge_rate:
        numbers["charge_rate"] = scaled(task.charge_rate, 0.2, 2.0)
        if random.random() < 0.5:
            numbers["pads"] = int(random.integers(1, task.pads + 2))
    return replace(task, **numbers)


def enlarge(task: TaskConfig, side: int) -> TaskConfig:
    """The task on square maps of another size, equally dense, with battery and time for the longer distances."""
    area, length = side * side / (task.width * task.height), side / task.width
    return replace(
        task,
        width=side,
        height=side,
        buildings=int(task.buildings * area),
        trees=int(task.trees * area),
        obstacles=int(task.obstacles * area),
        battery_capacity=round(task.battery_capacity * length),
        max_steps=round(task.max_steps * length),
        deliveries=task.deliveries if length == 1 else min(task.deliveries, FEW),
    )
