"""The settings of a tour network's training, and the tasks that it trains on."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from drone_env.core.tasks import TASKS, TaskConfig, custom_task_rules, get_task
from drone_env.errors import InvalidValueError
from drone_env.rl.config import Share, ShareBelowOne, check_values

ALL = "all"
SHARES = {
    "easy_delivery": 0.0,  # one parcel, one path: nothing to choose
    "medium_delivery": 0.06,
    "hard_delivery": 0.10,
    "skyline_easy": 0.14,
    "skyline_medium": 0.20,
    "skyline_hard": 0.35,
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

    unit: ClassVar[str] = "updates"
    """The field that sets the length of a training."""
    checkpoint_episodes: ClassVar[int] = 1
    """Minimum number of updates between two checkpoints."""

    task: str = ALL
    """The task, by its short name, id or grader; `all` for one network on all tasks and their variants."""
    initial: str = ""
    """File of an exported tour network to start from; empty for random weights."""
    updates: PositiveInt = 12_000
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
