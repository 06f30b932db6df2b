"""What a prompt may name: what the drone observes, and what its task says, as text."""

from collections.abc import Callable, Iterator, Sequence

from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.tasks import TaskConfig
from drone_env.llm.symbols import PLAIN, Symbols
from drone_env.models import DroneObservation

OWN = {Cell.DELIVERY: "parcel to deliver", Cell.DELIVERED: "delivered parcel", Cell.PAD: "charging pad"}
"""What prompts call kinds of cells whose own names say too little."""
TITLES = {Cell.BUILDING: "Buildings", Cell.TREE: "Trees", Cell.OBSTACLE: "Obstacles", Cell.PAD: "Charging pads"}


def _places(observation: DroneObservation) -> dict[str, str]:
    """Where the cells of each kind are, roads left out, by its name; in one pass, since a city has thousands."""
    found: dict[str, list[str]] = {kind.name: [] for kind in CELL_KINDS.values()}
    for y, line in enumerate(observation.cell_types):
        for x, name in enumerate(line):
            if name != "road":
                found[name].append(f"({x}, {y})")
    return {name: " ".join(places) or "none" for name, places in found.items()}


def _target(observation: DroneObservation) -> str:
    target = observation.current_target
    return "none" if target is None else f"({target[0]}, {target[1]})"


OBSERVED: dict[str, Callable[[DroneObservation], object]] = {
    "x": lambda seen: seen.drone_x,
    "y": lambda seen: seen.drone_y,
    "battery_percent": lambda seen: round(100 * seen.battery),
    "battery_steps": lambda seen: seen.battery_steps_remaining,
    "target": _target,
    "distance": lambda seen: round(seen.distance_to_target or 0),
    "deliveries_done": lambda seen: seen.deliveries_done,
    "deliveries_total": lambda seen: seen.deliveries_total,
    "step": lambda seen: seen.step_count,
    "steps_left": lambda seen: seen.max_steps - seen.step_count,
    "max_steps": lambda seen: seen.max_steps,
    "width": lambda seen: seen.grid_width,
    "height": lambda seen: seen.grid_height,
}
PLACES = {"parcels": "delivery", "buildings": "building", "trees": "tree", "obstacles": "obstacle", "pads": "pad"}
"""What prompts call the places of the cells of a kind."""
VALUES = {*OBSERVED, *PLACES, "grid", "legend", "history", "task", "drains", "impassable", "terrain", "joined"}
"""What a template may name."""
FIRST_VALUES = {*OBSERVED, *PLACES, "grid", "history", "rules"}
"""What one of the first form may name."""


def values_of(
    task: TaskConfig, observation: DroneObservation, last_steps: Sequence[str] = (), symbols: Symbols = PLAIN
) -> dict[str, object]:
    """All that templates may name, by name.

    Args:
        task: The task.
        observation: What the drone sees.
        last_steps: The last steps, each in a line.
        symbols: The letters of the grid.
    """
    from drone_env.envs.blocks import is_joined  # loads Pillow

    history = "\n".join(["", "Last steps:", *last_steps]) if last_steps else ""
    of_task, places = set(deciding(task)), _places(observation)
    seen = {name: of(observation) for name, of in OBSERVED.items()}
    seen |= {name: places[kind] for name, kind in PLACES.items()}
    return seen | {
        "grid": "\n".join(" ".join(symbols.letters[name] for name in line) for line in observation.cell_types),
        "legend": symbols.legend,
        "rules": _rules(task),
        "history": history,
        "task": task,
        "drains": [(_name(kind), units) for kind, units in task.drain if units != 1],
        "impassable": sorted(map(_name, task.impassable)),
        "terrain": [(title, places[CELL_KINDS[kind].name], kind in of_task) for kind, title in TITLES.items()],
        "joined": is_joined(task),
    }


def _name(kind: Cell) -> str:
    return OWN.get(kind, CELL_KINDS[kind].name)


def deciding(task: TaskConfig) -> Iterator[Cell]:
    """The kinds of terrain whose places decide how to fly over maps of a task."""
    for kind, count in task.cell_counts().items():
        charges = kind is Cell.PAD and task.charge_rate > 0
        if count and (charges or kind in task.impassable or dict(task.drain).get(kind, 1) != 1):
            yield kind


def _rules(task: TaskConfig) -> str:
    """What a step costs and what blocks the way, in the words of the first prompts."""
    drain = [f"{units} above a {CELL_KINDS[kind].name}" for kind, units in task.drain if units != 1]
    costs = f"Each step, WAIT too, costs 1 unit of battery{', but ' + ', '.join(drain) if drain else ''}."
    blocked = sorted(CELL_KINDS[kind].name for kind in task.impassable)
    lines = [costs, f"{' and '.join(blocked).capitalize()} cells block the way." if blocked else ""]
    if task.pads and task.charge_rate:
        lines.append(f"WAIT on a charging pad adds {task.charge_rate} units instead.")
    return " ".join(line for line in lines if line)
