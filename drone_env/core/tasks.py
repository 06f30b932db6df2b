"""The tasks and all their numbers. A new task is a new entry in `TASKS`."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, field, fields
from functools import cached_property, partial
from hashlib import sha256
from itertools import chain
from typing import Any

from drone_env.core.actions import Event
from drone_env.core.cells import Cell
from drone_env.core.terrain import Terrain, Window, shipped_terrain
from drone_env.errors import InvalidTaskError, UnknownNameError

MAX_SIDE = 128
"""Maximum side of a map in cells: cell numbers, with their flag, must fit the 16-bit state."""
MAX_DELIVERIES = 16
MAX_SPACING = 16
"""Maximum distance between streets: the tables for map generation grow with its square."""
MAX_UNITS = 32_000
"""Maximum number of steps and battery units, which must fit the 16-bit state."""

RANGES = (
    ("width height", 2, MAX_SIDE),
    ("deliveries", 1, MAX_DELIVERIES),
    ("max_steps battery_capacity", 1, MAX_UNITS),
    ("charge_rate", 0, MAX_UNITS),
    ("buildings trees obstacles pads", 0, math.inf),
    ("version", 1, math.inf),
)
"""The lowest and highest allowed values of a task's numbers."""

TERRAIN = (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.DELIVERY, Cell.DELIVERED, Cell.PAD)
"""The kinds of cell that can be below the drone. The order is frozen: telemetry encodes a kind by its index here."""


@dataclass(frozen=True)
class TaskConfig:
    """One task. Immutable and hashable.

    Attributes:
        id: Unique name, such as `easy_delivery`.
        short_name: Short unique name, such as `easy`.
        grader: `module:function` of the task's grader.
        version: Incremented by any change to a map, a reward or a score.
        width, height: Grid size in cells, at most 128 each.
        deliveries: Parcels to deliver, 1 to 16.
        buildings, trees, obstacles, pads: Number of cells of each kind.
        max_steps: Steps after which the episode ends.
        battery_capacity: Battery units at the start, which is also the maximum.
        r_delivery, r_battery_dead, r_wall, r_blocked, r_obstacle, r_building, r_tree, r_wait, r_step:
            Rewards of the events in profiles with `task_events`.
        drain: Battery units per step above each kind of cell; the default is 1.
        impassable: Kinds that the drone cannot enter.
        charge_rate: Battery units that a WAIT on a pad adds, instead of the drain.
        street_spacing: Distance between parallel streets, 2 to 16; it divides width and height. Two streets cross at
            the start. Buildings and trees are between the streets, everything else is on them. 0 for no streets.
        efficiency_needs_all: Whether battery and steps left count in the score only if everything is delivered.
        terrain: Fixed terrain. Every map is the whole of it or a window of it. The counts of cells are those of the
            whole terrain, except for pads: a map has the pads of its terrain, and random ones up to `pads`. Start and
            parcels that the terrain does not fix are on roads that are connected to each other.
        family: Group of the task in lists. It does not affect results.

    Raises:
        InvalidTaskError: on construction, if the numbers are out of range or contradict each other. `windows` raises
            it if the terrain has too little room.
    """

    id: str
    short_name: str
    grader: str
    width: int
    height: int
    deliveries: int
    buildings: int
    trees: int
    obstacles: int
    max_steps: int
    battery_capacity: int
    r_delivery: float
    r_battery_dead: float
    r_wall: float
    r_blocked: float
    r_obstacle: float
    r_building: float
    r_tree: float
    r_wait: float
    r_step: float
    version: int = 1
    pads: int = 0
    drain: tuple[tuple[Cell, int], ...] = ()
    impassable: frozenset[Cell] = field(default_factory=frozenset[Cell])
    charge_rate: int = 0
    street_spacing: int = 0
    efficiency_needs_all: bool = False
    family: str = "other"
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        def require(holds: bool, message: str) -> None:
            if not holds:
                raise InvalidTaskError(f"task {self.id!r}: {message}")

        for name in ("id", "short_name", "family"):
            value = getattr(self, name)
            valid = isinstance(value, str) and re.fullmatch("[a-z][a-z0-9_]*", value)
            require(bool(valid), f"{name} must be lower-case letters, digits and _, got {value!r}")
        for number in fields(self):
            value = getattr(self, number.name)
            if number.type is int:
                require(type(value) is int, f"{number.name} must be an integer, got {value!r}")
            elif number.type is float:
                finite = type(value) in (int, float) and math.isfinite(value)
                require(finite, f"{number.name} must be a finite number, got {value!r}")
        object.__setattr__(self, "drain", tuple((Cell(kind), units) for kind, units in self.drain))
        object.__setattr__(self, "impassable", frozenset(Cell(kind) for kind in self.impassable))
        for names, low, high in RANGES:
            for name in names.split():
                allowed = f"at least {low}" if high == math.inf else f"{low} to {high}"
                value = getattr(self, name)
                require(low <= value <= high, f"{name} must be {allowed}, got {value}")
        placed = 1 + self.deliveries + sum(self.cell_counts().values())
        fits = self.terrain is not None or placed <= self.width * self.height
        require(fits, f"{placed} things do not fit on {self.width * self.height} cells")
        self._check_streets(require)
        if self.terrain is not None:
            self._check_terrain(require, self.terrain)
        require(len(dict(self.drain)) == len(self.drain), "drain names a kind of cell twice")
        for kind, units in self.drain:
            require(kind in TERRAIN, f"drain is for kinds under the drone {[c.name for c in TERRAIN]}, got {kind.name}")
            fits = type(units) is int and 0 <= units <= MAX_UNITS
            require(fits, f"drain must be 0 to {MAX_UNITS} whole units, got {units!r} for {kind.name}")
        can_block = {Cell.BUILDING, Cell.TREE, Cell.OBSTACLE}
        require(self.impassable <= can_block, f"impassable may hold {sorted(c.name for c in can_block)}")

    def _check_terrain(self, require: Callable[[bool, str], None], terrain: Terrain) -> None:
        window, sides = (self.width, self.height), (terrain.width, terrain.height)
        least = terrain.count(Cell.PAD)
        given = f"deliveries must be {len(terrain.parcels)}, the parcels of the terrain, got {self.deliveries}"
        require(len(terrain.parcels) in (0, self.deliveries), given)
        if sides == window:
            require(self.pads >= least, f"pads must be at least the {least} of the terrain, got {self.pads}")
        else:
            size = " x ".join(map(str, sides))
            fits = self.width <= terrain.width and self.height <= terrain.height
            apart = 3 * self.width <= terrain.width or 3 * self.height <= terrain.height
            splits = "so that the windows of two splits share no cell"
            message = f"terrain of {size} cells must be three times as wide or high as a map, {splits}; got {window}"
            require(fits and apart, message)
            require(not terrain.fixed, "start and parcels cannot be fixed if each map is a window of the terrain")
            # Without pads, observations do not contain the kind of the cell below the drone, and the counts of cells in
            # a window do not imply it.
            require(self.pads > 0, "pads must be at least 1 if each map is a window of the terrain, got 0")
        inside = all(0 <= x < terrain.width and 0 <= y < terrain.height for x, y in terrain.fixed)
        different = inside and len(set(terrain.fixed)) == len(terrain.fixed)
        require(different, f"start and parcels must be different cells, got {terrain.fixed}")

    @cached_property
    def windows(self) -> dict[str, list[Window]]:
        """The windows for the maps of each split; empty without fixed terrain.

        Raises:
            InvalidTaskError: if the terrain has too little room.
        """
        terrain = self.terrain
        if terrain is None:
            return {}
        corners = terrain.corners(self.width, self.height)
        all_corners = list(dict.fromkeys(chain.from_iterable(corners.values())))
        windows = terrain.windows(all_corners, self.width, self.height, self.impassable)
        at = dict(zip(all_corners, windows, strict=True))
        # Fixed positions exist only if there is one window.
        apart = [(x, y) for x, y in terrain.fixed if y * self.width + x not in at[0, 0].drawn]
        if apart:
            message = f"start and parcels must be connected roads; {apart} are not"
            raise InvalidTaskError(f"task {self.id!r}: {message}")

        def needed(window: Window) -> int:
            return 1 + self.deliveries + max(0, self.pads - window.pads)

        usable: dict[str, list[Window]] = {}
        for split, here in corners.items():
            own = [at[corner] for corner in here]
            usable[split] = [w for w in own if w.pads <= self.pads and needed(w) <= len(w.drawn)]
            if not usable[split]:
                best = max(own, key=lambda window: len(window.drawn))
                anywhere = f", in any window of {split}" if len(at) > 1 else ""
                room = f"{len(best.drawn)} roads that are connected{anywhere}"
                raise InvalidTaskError(f"task {self.id!r}: {needed(best)} things do not fit on {room}")
        return usable

    def _check_streets(self, require: Callable[[bool, str], None]) -> None:
        spacing = self.street_spacing
        if spacing == 0:
            return
        divides = 1 < spacing <= MAX_SPACING and self.width % spacing == self.height % spacing == 0
        message = f"street_spacing must be 0, or 2 to {MAX_SPACING} and divide width and height, got {spacing}"
        require(divides, message)
        between = (self.width - self.width // spacing) * (self.height - self.height // spacing)
        on_streets = self.width * self.height - between
        blocks = self.buildings + self.trees
        require(blocks <= between, f"{blocks} buildings and trees do not fit on {between} cells between the streets")
        rest = 1 + self.deliveries + self.obstacles + self.pads
        require(rest <= on_streets, f"{rest} things do not fit on {on_streets} cells of street")

    @property
    def attribution(self) -> str:
        """The attribution that pictures of the terrain must show; may be empty."""
        return "" if self.terrain is None else self.terrain.attribution

    @cached_property
    def uniform(self) -> bool:
        """Whether every step costs one battery unit, nothing is impassable and nothing charges.

        Then the shortest path is the Manhattan distance, and the battery shows the steps left.
        """
        blocked = {Cell.BUILDING: self.buildings, Cell.TREE: self.trees, Cell.OBSTACLE: self.obstacles}
        return (
            all(units == 1 for _, units in self.drain)
            and not any(blocked[kind] for kind in self.impassable)
            and not (self.pads and self.charge_rate)
        )

    def rules(self) -> dict[str, Any]:
        """All rules of the task as JSON values, for hashes and datasets."""
        numbers = {name: value for name, value in asdict(self).items() if name not in ("family", "terrain")}
        fixed = {} if self.terrain is None else {"terrain": self.terrain.digest()}
        return numbers | {"impassable": sorted(self.impassable)} | fixed

    @cached_property
    def digest(self) -> str:
        """A hash of the rules, 16 hex digits. Fields with default values do not affect it."""
        usual: dict[str, Any] = {one.name: one.default for one in fields(self)} | {"impassable": []}
        own = {name: value for name, value in self.rules().items() if value != usual.get(name, MISSING)}
        return sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def telemetry_size(self) -> int:
        """Values in the telemetry: 5, 6 with the fraction of steps left, 13 with pads.

        The fraction of steps left is a value if the battery does not show it. With pads, the one-hot kind of the cell
        below the drone follows, one value for each of `TERRAIN`.
        """
        if self.pads:
            return 6 + len(TERRAIN)
        return 5 if self.uniform and self.battery_capacity == self.max_steps else 6

    @property
    def gym_id(self) -> str:
        """The Gymnasium id of the task."""
        name = "-".join(part.title() for part in self.short_name.split("_"))
        return f"DroneDelivery-{name}-v{self.version}"

    def cell_counts(self) -> dict[Cell, int]:
        """The number of cells of each kind of terrain, in the order of placement."""
        return {
            Cell.BUILDING: self.buildings,
            Cell.TREE: self.trees,
            Cell.OBSTACLE: self.obstacles,
            Cell.PAD: self.pads,
        }


OVER_CITIES: dict[str, Any] = {
    "drain": ((Cell.BUILDING, 3), (Cell.TREE, 2)),
    "impassable": frozenset({Cell.OBSTACLE}),
    "efficiency_needs_all": True,
}
"""Battery costs and score rule of all cities, random or real."""

EASY, MEDIUM, HARD = (0.95, 0.10), (0.90, 0.15), (0.85, 0.25)
"""Rewards of `tiered` by level: of a delivery, and of all other events."""


def _rewards(r_delivery: float, r_other: float) -> dict[str, Any]:
    others = {f"r_{event.name.lower()}": r_other for event in Event if event is not Event.NONE}
    return others | {"r_delivery": r_delivery}


def _size(side: int, deliveries: int, steps: int) -> dict[str, int]:
    return {"width": side, "height": side, "deliveries": deliveries, "max_steps": steps}


def _task(
    short_name: str,
    side: int,
    terrain: tuple[int, int, int],
    deliveries: int,
    steps: int,
    rewards: tuple[float, float],
    **numbers: Any,
) -> TaskConfig:
    """A task on random maps. `terrain` is (buildings, trees, obstacles), `rewards` is (delivery, other events)."""
    buildings, trees, obstacles = terrain
    standard: dict[str, Any] = {"id": f"{short_name}_delivery", "battery_capacity": steps, "family": "standard"}
    return TaskConfig(
        short_name=short_name,
        grader=f"drone_env.graders:grade_{short_name}",
        buildings=buildings,
        trees=trees,
        obstacles=obstacles,
        **_size(side, deliveries, steps),
        **_rewards(*rewards),
        **standard | numbers,
    )


def _city(family: str, level: str, *numbers: Any, **others: Any) -> TaskConfig:
    """A city of streets and blocks, with pads. The battery is too small for the whole tour."""
    name = f"{family}_{level}"
    return _task(name, *numbers, id=name, street_spacing=4, family=family, **OVER_CITIES, **others)


_skyline = partial(_city, "skyline", version=2)
_rush = partial(_city, "rush")


def task_on(terrain: Terrain, name: str, **numbers: Any) -> TaskConfig:
    """A task on fixed terrain, with the costs of skyline.

    Args:
        terrain: The terrain.
        name: Id and short name of the task.
        numbers: `width`, `height`, `deliveries`, `pads`, `max_steps`, `battery_capacity`, `charge_rate`.
    """
    return TaskConfig(
        id=name,
        short_name=name,
        grader=f"drone_env.graders:grade_{name}",
        family="city",
        buildings=terrain.count(Cell.BUILDING),
        trees=terrain.count(Cell.TREE),
        obstacles=terrain.count(Cell.OBSTACLE),
        terrain=terrain,
        **_rewards(*HARD),
        **OVER_CITIES,
        **numbers,
    )


def _helsinki(name: str, file: str, side: int, deliveries: int, steps: int, **numbers: int) -> TaskConfig:
    return task_on(shipped_terrain(file), name, **_size(side, deliveries, steps), **numbers)


TASKS: dict[str, TaskConfig] = {
    task.id: task
    for task in (
        _task("easy", 10, (4, 4, 3), deliveries=1, steps=60, rewards=EASY),
        _task("medium", 14, (8, 6, 6), deliveries=3, steps=100, rewards=MEDIUM),
        _task("hard", 18, (12, 10, 10), deliveries=5, steps=160, rewards=HARD),
        _skyline("easy", 8, (18, 6, 3), 3, 60, EASY, pads=5, battery_capacity=11, charge_rate=4),
        _skyline("medium", 12, (40, 14, 8), 4, 100, MEDIUM, pads=4, battery_capacity=18, charge_rate=4),
        _skyline("hard", 16, (80, 24, 14), 5, 160, HARD, pads=5, battery_capacity=26, charge_rate=5),
        # More parcels than the steps allow: which ones to leave is part of the plan.
        _rush("easy", 8, (18, 6, 1), 9, 16, EASY, pads=2, battery_capacity=9, charge_rate=3),
        _rush("medium", 12, (40, 14, 2), 9, 32, MEDIUM, pads=3, battery_capacity=13, charge_rate=2),
        _rush("hard", 16, (80, 24, 4), 10, 40, HARD, pads=3, battery_capacity=16, charge_rate=2),
        _helsinki("city_small", "helsinki_8", 16, 4, 160, pads=5, battery_capacity=26, charge_rate=5),
        _helsinki("city", "helsinki_16", 64, 5, 640, pads=8, battery_capacity=80, charge_rate=8),
    )
}
"""Every task in its current version, by id."""


PACKAGE_TASKS = frozenset(TASKS)
"""The ids of the tasks in this package; id and version identify their rules."""

TASK_FINDERS: list[Callable[[str], TaskConfig | None]] = []
"""Functions that find further tasks by name, such as maps stored by the server; called in order."""


def custom_task_rules(*tasks: TaskConfig) -> dict[str, str]:
    """The digests of tasks that are not in this package, because their names do not identify their rules."""
    return {f"rules of {task.id}": task.digest for task in tasks if task.id not in PACKAGE_TASKS}


def get_task(name: str | TaskConfig, version: int | None = None) -> TaskConfig:
    """The task with this id, short name or grader id; a `TaskConfig` is returned unchanged.

    Raises:
        UnknownNameError: if there is no such task or version; the message lists the valid ones.
    """
    if isinstance(name, TaskConfig):
        task = name
    else:
        named = [task for task in TASKS.values() if name in (task.id, task.short_name, task.grader)]
        found = named or [task for find in TASK_FINDERS if (task := find(name)) is not None]
        if not found:
            raise UnknownNameError("task", name, [task.short_name for task in TASKS.values()], also=TASKS)
        task = found[0]
    if version not in (None, task.version):
        raise UnknownNameError(f"version of task {task.id!r}", version, [str(task.version)])
    return task
