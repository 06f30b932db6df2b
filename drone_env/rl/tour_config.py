"""All that decides how a tour network is trained. A new hyperparameter is one more field."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from drone_env.core.tasks import TASKS, TaskConfig, get_task, own_rules
from drone_env.errors import InvalidValueError

ALL = "all"
SHARES = {
    "easy_delivery": 0.0,  # one parcel and one way to it: nothing to choose
    "medium_delivery": 0.06,
    "hard_delivery": 0.10,
    "skyline_easy": 0.14,
    "skyline_medium": 0.20,
    "skyline_hard": 0.35,
}
"""How much of a training on all tasks each of them takes; what is left goes to `VARIANTS`."""
VARIANTS = (
    ("skyline_easy", 2, 4),
    ("skyline_easy", 4, 3),
    ("skyline_medium", 3, 6),
    ("skyline_medium", 5, 5),
    ("skyline_hard", 3, 6),
    ("skyline_hard", 4, 4),
)
"""Task, parcels, pads: so that a network sees other counts than those of the tasks."""
LARGEST_SIDE, FEW = 48, 4
"""Side of the largest map that a task is enlarged to, and the most parcels there: exact values of more take seconds."""
MOST = {"seed": 2**63 - 1, "num_threads": 256, "batch_size": 1 << 16}
"""The largest that some fields may be: PyTorch takes no greater seeds."""
MOST_STATES = 1 << 17
"""In a chunk: those of 128 kB each take 16 GB."""


@dataclass(frozen=True)
class TourConfig:
    """One training of a tour network.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if a number is out of range.
    """

    task: str = ALL
    """The task, by its short name, id or grader; `all` for one network that learns all of them, and variants."""
    kind: Literal["distilled", "rewards"] = "distilled"
    """What it learns from: the exact value of each option, or the scores of plans that it tries alone."""
    initial: str = ""
    """File of an exported tour network whose weights it starts from; random ones if empty."""
    updates: int = 12_000
    """Updates in all; the learning rate falls to its end over them."""
    seed: int = 0
    """Of the weights, the maps and the batches: equal seeds, equal runs (on a CPU)."""
    num_threads: int = 1
    """Threads that PyTorch computes with; one more draws lessons. Runs with other numbers differ in the last bits."""
    batch_size: int = 512
    """States per update, of one task: a quarter of each of four chunks."""
    learning_rate: float = 1e-3
    """Of AdamW, at its highest."""
    final_learning_rate: float = 1e-5
    """At the last update; it falls along half a cosine."""
    warm_up: int = 200
    """Updates over which the learning rate rises."""
    weight_decay: float = 1e-4
    """Of AdamW."""
    max_grad_norm: float = 1.0
    """Gradients longer than this are shortened to it."""
    temperature: float = 0.004
    """Regret, in score, at which the wanted probability of an option has fallen to 1 / e of the best one's."""
    regret_weight: float = 100.0
    """What expected regret costs, beside the cross-entropy."""
    completion_weight: float = 2.0
    """What the error about missions that can still be completed costs."""
    average: float = 0.998
    """Share that the average of the weights, which is what flies, keeps at each update."""
    maps_per_chunk: int = 8
    """Maps that are drawn together; one chunk is drawn for each update."""
    states_per_map: int = 128
    """States of each map."""
    randomised: float = 0.6
    """Probability that a chunk is drawn on a task with other numbers (`randomise`), if it learns from exact values."""
    plans: int = 16
    """Plans that are flown from each state where it learns from rewards."""
    window: int = 24
    """Chunks of each task that batches are drawn from: the last ones."""
    validation_every: int = 1_000
    """Updates between two validations."""
    validation_maps: int = 200
    """Maps of the validation split of each task that each flies."""
    log_every: int = 100
    """Updates per line of the log."""
    checkpoint_seconds: float = 30.0
    """At least this many seconds between two checkpoints."""

    def __post_init__(self) -> None:
        if self.task != ALL:
            task = get_task(self.task)
            one_way = task.uniform and task.deliveries == 1
            _require(not one_way, f"there is nothing to choose on {task.id!r}: one parcel, and one way to it")
        positive = (
            "updates", "num_threads", "batch_size", "learning_rate", "temperature", "maps_per_chunk", "states_per_map",
            "window", "plans", "validation_every", "validation_maps", "log_every", "max_grad_norm",
        )  # fmt: skip
        for name in positive:
            _require(getattr(self, name) > 0, f"{name} must be above 0, got {getattr(self, name)}")
        for name in (
            "final_learning_rate", "warm_up", "weight_decay", "regret_weight", "completion_weight", "seed",
            "checkpoint_seconds",
        ):  # fmt: skip
            _require(getattr(self, name) >= 0, f"{name} must not be below 0, got {getattr(self, name)}")
        for name, value in asdict(self).items():
            _require(
                not isinstance(value, float) or math.isfinite(value), f"{name} must be a finite number, got {value}"
            )
            most = MOST.get(name)
            _require(most is None or value <= most, f"{name} must be at most {most}, got {value}")
        states = self.maps_per_chunk * self.states_per_map
        _require(
            states <= MOST_STATES, f"maps_per_chunk times states_per_map must be at most {MOST_STATES}, got {states}"
        )
        _require(self.batch_size % 4 == 0, f"batch_size must be a multiple of 4, got {self.batch_size}")
        _require(0 <= self.average < 1, f"average must be in [0, 1), got {self.average}")
        _require(0 <= self.randomised <= 1, f"randomised must be in [0, 1], got {self.randomised}")

    @property
    def name(self) -> str:
        """Of the files."""
        parts = ["tournet", *(["rewards"] if self.kind == "rewards" else [])]
        return "_".join(parts if self.task == ALL else [*parts, get_task(self.task).short_name])

    def tasks(self) -> list[TaskConfig]:
        """The tasks that are learned and validated."""
        return list(map(get_task, SHARES)) if self.task == ALL else [get_task(self.task)]

    def lessons(self) -> dict[TaskConfig, float]:
        """What lessons are drawn on, and the share of each."""
        if self.task != ALL:
            return {get_task(self.task): 1.0}
        shares = {get_task(name): share for name, share in SHARES.items() if share}
        rest = 1 - sum(shares.values())
        return shares | {variant(*of): rest / len(VARIANTS) for of in VARIANTS}

    def identity(self) -> dict[str, Any]:
        """What a resumed run must share with the one that it goes on from."""
        return {name: value for name, value in asdict(self).items() if name != "checkpoint_seconds"} | {
            "task": ALL if self.task == ALL else get_task(self.task).id,
            "tasks": {task.id: task.version for task in self.tasks()},
            **own_rules(*self.tasks()),
        }


def variant(name: str, deliveries: int, pads: int) -> TaskConfig:
    """A task with other counts of parcels and pads; it is registered nowhere."""
    task = TASKS[name]
    changed = f"{task.id}_{deliveries}_{pads}"
    return replace(task, id=changed, short_name=changed, grader="", deliveries=deliveries, pads=pads)


def randomise(task: TaskConfig, random: np.random.Generator) -> TaskConfig:
    """The task with other numbers: each is drawn anew with probability 1/2, and one map in three is larger."""

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
    """The task on square maps of another size: as densely built, with battery and time for the longer ways."""
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


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InvalidValueError(message)
