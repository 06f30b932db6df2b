"""A city: the terrain of a place, its file and its task.

    format = 1
    attribution = "© OpenStreetMap contributors, ODbL-1.0"
    cell = 16.0                                       # side of a cell in metres
    bbox = [24.9386, 60.1656, 24.9462, 60.1677]       # west, south, east, north in degrees (WGS 84)
    start = [0, 1]                                    # [x, y]; x grows rightwards from 0, y downwards
    parcels = [[3, 0]]
    names = [["Kluuvi", 2.5, 0.5], ["Kaivokatu", 2.0, 1.0, -6]]   # text, x, y; of a street its degrees clockwise

    [task]
    deliveries = 1                                    # see `TaskNumber` for the other keys

    [terrain]
    rows = [
        "🏢· · · ",
        "· 🌳🚧🔋",
    ]

All keys but `format` and `terrain` are optional. A row consists of the symbols of `draw_text`: `· ` (a dot and a space)
is a road, 🏢 a building, 🌳 a tree, 🚧 an obstacle, 🔋 a pad.
"""

import json
import re
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from drone_env.core.cells import SYMBOLS, Cell
from drone_env.core.tasks import MAX_DELIVERIES, TaskConfig, task_on
from drone_env.core.terrain import PLACED, XY, Name, Terrain, pieces
from drone_env.errors import InvalidTaskError, InvalidValueError, abbreviate
from drone_env.files import read_file, write_text
from drone_env.toml_text import read_toml

MIN_SIDE, MAX_SIDE = 2, 512
"""Cells along a side of a city. Maps of a task have at most `core.tasks.MAX_SIDE`."""
MAX_FILE = 2 << 20
"""Bytes: the largest city takes 1 MiB."""
MAX_NAMES = 100
MAX_TEXT = 200
"""Characters of a text: frames and pictures repeat it in one line."""
CELL_OF = {SYMBOLS[kind]: kind for kind in PLACED}
SYMBOL = re.compile("|".join(CELL_OF))
ALLOWED = ", ".join(f"{symbol!r} {kind.name.lower()}" for symbol, kind in CELL_OF.items())
TaskNumber = Literal["width", "height", "deliveries", "max_steps", "battery_capacity", "charge_rate", "pads"]
"""The numbers of a task that a city can set; `task_of` sets the others."""
DELIVERIES, PADS, CHARGE_RATE = 5, 4, 5
BBox = tuple[float, float, float, float]
"""West, south, east, north in degrees (WGS 84)."""


@dataclass(frozen=True, eq=False)
class City:
    """The terrain of a place. None or an empty value means unknown, or drawn for each map.

    Attributes:
        grid: uint8[height, width], cell ids out of `PLACED`; `grid[y, x]`.
        attribution: Owner and licence of the data.
        cell: Side of a cell in metres.
        bbox: West, south, east, north in degrees (WGS 84).
        start: (x, y) of the start, a road.
        parcels: (x, y) of each parcel: roads that are connected with the start and each other.
        numbers: Numbers of the task.
        names: Names of streets and districts.

    Raises:
        InvalidTaskError: on construction, if a value is invalid.
    """

    grid: npt.NDArray[np.uint8]
    attribution: str = ""
    cell: float | None = None
    bbox: BBox | None = None
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict[str, int])
    names: tuple[Name, ...] = ()

    def __post_init__(self) -> None:
        height, width = self.grid.shape
        sides = f"a city is {MIN_SIDE} to {MAX_SIDE} cells wide and high"
        _require(MIN_SIDE <= min(width, height) and max(width, height) <= MAX_SIDE, f"{sides}, got {width} x {height}")
        _require(len(self.names) <= MAX_NAMES, f"at most {MAX_NAMES} names, got {len(self.names)}")
        texts = [("attribution", self.attribution), *(("a name", name.text) for name in self.names)]
        for name, text in texts:
            fits = text.isprintable() and len(text) <= MAX_TEXT
            _require(
                fits, f"{name} must be one printable line of at most {MAX_TEXT} characters, got {abbreviate(text)}"
            )
        _require(self.cell is None or 0 < self.cell < inf, f"cell must be metres above 0, got {self.cell}")
        if self.bbox is not None:
            check_bbox(self.bbox)
        _require(len(self.parcels) <= MAX_DELIVERIES, f"at most {MAX_DELIVERIES} parcels, got {len(self.parcels)}")
        stops = {"the start": self.start} if self.start is not None else {}
        stops.update({f"parcel {i}": parcel for i, parcel in enumerate(self.parcels, 1)})
        _require(len({*stops.values()}) == len(stops), "start and parcels must be on distinct cells")
        connected = pieces(self.grid == Cell.OBSTACLE)
        origin = next(iter(stops), "")
        for name, (x, y) in stops.items():
            _require(0 <= x < width and 0 <= y < height, f"{name} [{x}, {y}] is outside the {width} x {height} cells")
            _require(self.grid[y, x] == Cell.ROAD, f"{name} [{x}, {y}] must be on a road")
            reached = connected[y, x] == connected[stops[origin][1], stops[origin][0]]
            _require(reached, f"obstacles block every way from {origin} to {name} [{x}, {y}]")


class Rows(BaseModel):
    """The table `[terrain]`."""

    model_config = ConfigDict(strict=True, extra="forbid")

    rows: Annotated[list[str], Field(min_length=1, fail_fast=True)]


class CityFile(BaseModel):
    """The keys and types of the file of a city; `City` validates the values."""

    model_config = ConfigDict(strict=True, extra="forbid")

    format: Literal[1]
    attribution: str = ""
    cell: FiniteFloat | None = None
    bbox: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None, Field(strict=False)] = None
    start: Annotated[XY | None, Field(strict=False)] = None
    parcels: Annotated[tuple[Annotated[XY, Field(strict=False)], ...], Field(strict=False, fail_fast=True)] = ()
    names: Annotated[tuple[Name, ...], Field(strict=False, fail_fast=True)] = ()
    task: dict[TaskNumber, int] = {}
    terrain: Rows


def check_bbox(bbox: Iterable[float]) -> None:
    """Raise `InvalidTaskError` unless a bounding box has west < east and south < north, within the world."""
    west, south, east, north = bbox
    spans = -180 <= west < east <= 180 and -85 <= south < north <= 85
    allowed = "-180 <= west < east <= 180 and -85 <= south < north <= 85"
    _require(spans, f"bbox is west, south, east, north in degrees, {allowed}; got {west}, {south}, {east}, {north}")


def city_text(city: City) -> str:
    """Return the text of the file of a city; equal cities give equal texts."""
    lines = ["format = 1"]
    lines += [f"attribution = {json.dumps(city.attribution, ensure_ascii=False)}"] * bool(city.attribution)
    lines += [f"cell = {city.cell!r}"] * (city.cell is not None)
    lines += [f"bbox = {list(city.bbox or ())!r}"] * (city.bbox is not None)
    lines += [f"start = {list(city.start or ())!r}"] * (city.start is not None)
    lines += [f"parcels = {[list(parcel) for parcel in city.parcels]!r}"] * bool(city.parcels)
    names = [json.dumps([part for part in name if part is not None], ensure_ascii=False) for name in city.names]
    lines += ["names = [", *(f"    {name}," for name in names), "]"] if names else []
    numbers = [f"{name} = {city.numbers[name]}" for name in get_args(TaskNumber) if name in city.numbers]
    lines += ["", "[task]", *numbers] if numbers else []
    lines += ["", "[terrain]", "rows = [", *(f'    "{row}",' for row in text_rows(city.grid)), "]"]
    return "\n".join(lines) + "\n"


def text_rows(grid: npt.NDArray[np.uint8]) -> list[str]:
    """Return the rows of a grid as text."""
    return ["".join(SYMBOLS[kind] for kind in row) for row in grid.tolist()]


def write_city(city: City, path: str | Path) -> None:
    """Write the file of a city atomically.

    Raises:
        OSError: if it cannot be written.
    """
    write_text(Path(path), city_text(city))


def read_city(path: str | Path) -> City:
    """Read the file of a city.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a regular file, or too large.
        InvalidTaskError: if it is not a city.
    """
    content = read_file(path, MAX_FILE)
    with _naming(path):
        return parse_city(content)


def parse_city(content: str | bytes) -> City:
    """Parse the text of the file of a city.

    Args:
        content: The text, or its UTF-8.

    Raises:
        InvalidValueError: if it is not a city.
    """
    file = read_toml(content, CityFile)
    grid = [_kinds(row, y) for y, row in enumerate(file.terrain.rows)]
    for y, row in enumerate(grid):
        wide = f"rows must be equally wide: row 0 has {len(grid[0])} cells, row {y} has {len(row)}"
        _require(len(row) == len(grid[0]), wide)
    values = file.model_dump(exclude={"format", "names", "task", "terrain"})
    return City(np.array(grid, np.uint8), numbers={**file.task}, names=file.names, **values)


def task_of(city: City, name: str) -> TaskConfig:
    """Make a task of a city. As in `skyline`, obstacles are closed, and buildings and trees cost more.

    Defaults of the numbers: maps are as large as the city, and smaller windows have 4 pads; 5 parcels unless the city
    fixes them; `max_steps` is 5 times width + height; the battery lasts 1.5 times width + height if there are pads,
    else `max_steps`.

    Args:
        city: The city.
        name: Id and short name of the task.

    Raises:
        InvalidTaskError: if the name is invalid, the city is too large, or its numbers do not fit.
    """
    rows, columns = city.grid.shape
    width, height = city.numbers.get("width", columns), city.numbers.get("height", rows)
    cells = city.grid.tobytes()
    terrain = Terrain(cells, columns, city.start, city.parcels, city.attribution, city.cell, city.names)
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
    task = task_on(terrain, name, **numbers)
    _ = task.windows  # raises if the numbers do not fit
    return task


def city_task(path: str | Path) -> TaskConfig:
    """Make the task of a city's file, named by the file without its suffix.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a regular file, or too large.
        InvalidTaskError: if it is not a city that can be a task.
    """
    city = read_city(path)
    with _naming(path):
        return task_of(city, Path(path).stem)


@contextmanager
def _naming(path: str | Path) -> Generator[None, None, None]:
    """Put the path before errors."""
    try:
        yield
    except InvalidValueError as error:
        raise InvalidTaskError(f"city {path}: {error}") from None


def _kinds(row: str, y: int) -> list[int]:
    unknown = SYMBOL.sub("", row)
    _require(not unknown, f"unknown symbol {unknown[:2]!r} in row {y}; allowed: {ALLOWED}")
    return [CELL_OF[symbol] for symbol in SYMBOL.findall(row)]


def _require(holds: bool | np.bool_, message: str) -> None:
    if not holds:
        raise InvalidTaskError(message)
