"""A city as a task: its terrain is that of every map."""

from pathlib import Path

from drone_env.city.city_file import City, read_city
from drone_env.core.cells import Cell
from drone_env.core.tasks import MAX_SIDE, TaskConfig, task_on
from drone_env.core.terrain import Terrain
from drone_env.errors import InvalidTaskError

DELIVERIES = 5
PADS = 4
CHARGE_RATE = 5


def task_of(city: City, name: str) -> TaskConfig:
    """The task whose maps are drawn on a city: as `skyline`, obstacles are closed, and buildings and trees cost more.

    What the city's numbers leave open: maps as large as the city, or else windows of it with 4 pads; 5 parcels, or as
    many as it fixes; as many steps as five times width and height of a map; where there is a pad, half as many again as
    width and height of battery units, else as many as steps.

    Args:
        city: The city.
        name: Id and short name of the task.

    Raises:
        InvalidTaskError: if the name is none, the city is too large, or its numbers do not fit; the message says why.
    """
    rows, columns = city.grid.shape
    width, height = city.numbers.get("width", columns), city.numbers.get("height", rows)
    terrain = Terrain(city.grid.tobytes(), columns, city.start, city.parcels, city.attribution)
    pads = city.numbers.get("pads", terrain.count(Cell.PAD) if (width, height) == (columns, rows) else PADS)
    max_steps = 5 * (width + height)
    numbers = {
        "deliveries": len(city.parcels) or DELIVERIES,
        "max_steps": max_steps,
        "battery_capacity": 3 * (width + height) // 2 if pads else city.numbers.get("max_steps", max_steps),
        "charge_rate": CHARGE_RATE if pads else 0,
        **city.numbers,
        "width": width,
        "height": height,
        "pads": pads,
    }
    if max(width, height) > MAX_SIDE:
        sides = f"width and height must be 2 to {MAX_SIDE}, got {(width, height)}"
        raise InvalidTaskError(
            f"task {name!r}: {sides}; a city may name less in [task], for maps that are windows of it"
        )
    task = task_on(terrain, name, **numbers)
    _ = task.windows  # what does not fit is refused here
    return task


def city_task(path: str | Path) -> TaskConfig:
    """The task of a city's file; its name is the file's, without the suffix.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is no city, or none that can be a task; the message says why.
    """
    city = read_city(path)
    try:
        return task_of(city, Path(path).stem)
    except InvalidTaskError as error:
        raise InvalidTaskError(f"city {path}: {error}") from None
