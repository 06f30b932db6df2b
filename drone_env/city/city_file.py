"""A city: the terrain of a place, its file, and its task.

    format = 1
    attribution = "© OpenStreetMap contributors"
    licence = "ODbL-1.0"
    source = "helsinki.osm.pbf"                       # the name of the file that it was made from
    cell = 16.0                                       # metres along the side of a cell
    bbox = [24.9386, 60.1656, 24.9462, 60.1677]       # west, south, east, north in degrees (WGS 84)
    start = [0, 1]                                    # [x, y]; x grows rightwards from 0, y downwards
    parcels = [[3, 0]]

    [task]
    deliveries = 1                                    # and the other `NUMBERS`

    [terrain]
    rows = [
        "🏢· · · ",
        "· 🌳🚧🔋",
    ]

Every key but `format` and `terrain` may be left out. A row holds the symbols of `draw_text`: `· ` (a dot and a space)
for a road, 🏢, 🌳, 🚧 for what cannot be entered, 🔋 for a pad.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from drone_env.core.cells import SYMBOLS, Cell
from drone_env.core.tasks import MAX_DELIVERIES, TaskConfig, task_on
from drone_env.core.terrain import PLACED, XY, Terrain, pieces
from drone_env.errors import InvalidTaskError, InvalidValueError, shown
from drone_env.files import read_file, write_text
from drone_env.toml_text import read_toml

MIN_SIDE, MAX_SIDE = 2, 512
"""Cells along a side of a city. A task flies at most `core.tasks.MAX_SIDE` of them."""
MAX_FILE = 2 << 20
"""Bytes: the largest city takes 1 MiB."""
MAX_TEXT = 200
"""Characters of a text: one line, which frames and pictures repeat."""
CELL_OF = {SYMBOLS[kind]: kind for kind in PLACED}
ALLOWED = ", ".join(f"{symbol!r} {kind.name.lower()}" for symbol, kind in CELL_OF.items())
TEXTS = ("attribution", "licence", "source")
Number = Literal["width", "height", "deliveries", "max_steps", "battery_capacity", "charge_rate", "pads"]
"""The numbers of a task that a city may name; `task_of` sets the others."""
DELIVERIES, PADS, CHARGE_RATE = 5, 4, 5
BBox = tuple[float, float, float, float]
"""West, south, east, north in degrees (WGS 84)."""


@dataclass(frozen=True, eq=False)
class City:
    """The terrain of a place. What is None or empty is not known, or is left to the seed of a map.

    Attributes:
        grid: uint8[height, width], cell ids, of those in `PLACED`; `grid[y, x]`.
        attribution, licence, source: Whose data it is, under which licence it may be handed on, and the name of the
            file that it was made from.
        cell: Metres along the side of a cell.
        bbox: West, south, east, north in degrees (WGS 84).
        start: (x, y) of the start, a road.
        parcels: (x, y) of each parcel, by its index: roads that can be reached from the start and from each other.
        numbers: Those that the city names for its task.

    Raises:
        InvalidTaskError: on construction, if it contradicts this; the message says where.
    """

    grid: npt.NDArray[np.uint8]
    attribution: str = ""
    licence: str = ""
    source: str = ""
    cell: float | None = None
    bbox: BBox | None = None
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict[str, int])

    def __post_init__(self) -> None:
        height, width = self.grid.shape
        sides = f"a city is {MIN_SIDE} to {MAX_SIDE} cells wide and high"
        _require(MIN_SIDE <= min(width, height) and max(width, height) <= MAX_SIDE, f"{sides}, got {width} x {height}")
        for name in TEXTS:
            text = getattr(self, name)
            fits = text.isprintable() and len(text) <= MAX_TEXT
            _require(fits, f"{name} must be one printable line of at most {MAX_TEXT} characters, got {shown(text)}")
        _require(self.cell is None or 0 < self.cell < inf, f"cell must be metres above 0, got {self.cell}")
        if self.bbox is not None:
            check_bbox(self.bbox)
        _require(len(self.parcels) <= MAX_DELIVERIES, f"at most {MAX_DELIVERIES} parcels, got {len(self.parcels)}")
        stops = [] if self.start is None else [("start", self.start)]
        stops += [(f"parcel {i}", parcel) for i, parcel in enumerate(self.parcels)]
        taken: dict[XY, str] = {}
        for name, (x, y) in stops:
            _require(0 <= x < width and 0 <= y < height, f"{name} [{x}, {y}] is outside the {width} x {height} cells")
            kind = Cell(self.grid[y, x])
            _require(kind == Cell.ROAD, f"{name} [{x}, {y}] must be on a road, there is {_named(kind)}")
            _require((x, y) not in taken, f"{name} is where {taken.get((x, y))} is, at [{x}, {y}]")
            taken[x, y] = name
        if taken:
            (x, y), *others = taken
            piece = pieces(self.grid == Cell.OBSTACLE)
            for at in others:
                message = f"{taken[at]} {list(at)} cannot be reached from {taken[x, y]} [{x}, {y}]"
                _require(bool(piece[at[1], at[0]] == piece[y, x]), message)


class Rows(BaseModel):
    """The table `[terrain]` of a city's file."""

    model_config = ConfigDict(strict=True, extra="forbid")

    rows: Annotated[list[str], Field(min_length=1)]


class CityFile(BaseModel):
    """The file of a city; `City` checks what its values mean."""

    model_config = ConfigDict(strict=True, extra="forbid")

    format: Literal[1]
    attribution: str = ""
    licence: str = ""
    source: str = ""
    cell: FiniteFloat | None = None
    bbox: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None, Field(strict=False)] = None
    start: Annotated[XY | None, Field(strict=False)] = None
    parcels: Annotated[tuple[Annotated[XY, Field(strict=False)], ...], Field(strict=False)] = ()
    task: dict[Number, int] = {}
    terrain: Rows


def check_bbox(bbox: Iterable[float]) -> None:
    """See that west, south, east, north span a piece of the world.

    Raises:
        InvalidTaskError: if they do not.
    """
    west, south, east, north = bbox
    # A comparison with what is not a number is False.
    spans = -180 <= west < east <= 180 and -85 <= south < north <= 85
    allowed = "-180 <= west < east <= 180 and -85 <= south < north <= 85"
    _require(spans, f"bbox is west, south, east, north in degrees, {allowed}; got {west}, {south}, {east}, {north}")


def city_text(city: City) -> str:
    """The file of a city; equal cities give equal texts."""
    lines = ["format = 1"]
    lines += [f"{name} = {json.dumps(text, ensure_ascii=False)}" for name in TEXTS if (text := getattr(city, name))]
    lines += [f"cell = {city.cell!r}"] * (city.cell is not None)
    lines += [f"bbox = {list(city.bbox or ())!r}"] * (city.bbox is not None)
    lines += [f"start = {list(city.start or ())!r}"] * (city.start is not None)
    lines += [f"parcels = {[list(parcel) for parcel in city.parcels]!r}"] * bool(city.parcels)
    numbers = [f"{name} = {city.numbers[name]}" for name in get_args(Number) if name in city.numbers]
    lines += ["", "[task]", *numbers] if numbers else []
    lines += ["", "[terrain]", "rows = [", *(f'    "{row}",' for row in text_rows(city.grid)), "]"]
    return "\n".join(lines) + "\n"


def text_rows(grid: npt.NDArray[np.uint8]) -> list[str]:
    """The rows of a grid as text."""
    return ["".join(SYMBOLS[kind] for kind in row) for row in grid.tolist()]


def write_city(city: City, path: str | Path) -> None:
    """Write the file of a city, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    write_text(Path(path), city_text(city))


def read_city(path: str | Path) -> City:
    """The city in a file.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is not a city.
    """
    try:
        content = read_file(path, MAX_FILE)
    except InvalidValueError as error:
        raise InvalidTaskError(f"city {error}") from None
    try:
        return parse_city(content)
    except InvalidTaskError as error:
        raise InvalidTaskError(f"city {path}: {error}") from None


def parse_city(content: str | bytes) -> City:
    """The city in the text of a file, or in its UTF-8.

    Raises:
        InvalidTaskError: if it is not a city.
    """
    try:
        file = read_toml(content, CityFile)
    except InvalidValueError as error:
        raise InvalidTaskError(str(error)) from None
    grid = [_kinds(row, y) for y, row in enumerate(file.terrain.rows)]
    for y, row in enumerate(grid):
        wide = f"rows must be equally wide: row 0 has {len(grid[0])} cells, row {y} has {len(row)}"
        _require(len(row) == len(grid[0]), wide)
    values = {name: getattr(file, name) for name in (*TEXTS, "cell", "bbox", "start", "parcels")}
    return City(np.array(grid, np.uint8), numbers={**file.task}, **values)


def task_of(city: City, name: str) -> TaskConfig:
    """The task whose maps are drawn on a city: as `skyline`, obstacles are closed, and buildings and trees cost more.

    What the city's numbers leave open: maps as large as the city, or else windows of it with 4 pads; 5 parcels, or as
    many as it fixes; as many steps as five times width and height of a map; where there is a pad, half as many again as
    width and height of battery units, else as many as steps.

    Args:
        city: The city.
        name: Id and short name of the task.

    Raises:
        InvalidTaskError: if the name is none, the city is too large, or its numbers do not fit.
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
    task = task_on(terrain, name, **numbers)
    _ = task.windows  # what does not fit is refused here
    return task


def city_task(path: str | Path) -> TaskConfig:
    """The task of a city's file, named by the file without its suffix.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is no city, or none that can be a task.
    """
    city = read_city(path)
    try:
        return task_of(city, Path(path).stem)
    except InvalidTaskError as error:
        raise InvalidTaskError(f"city {path}: {error}") from None


def _kinds(row: str, y: int) -> list[int]:
    kinds: list[int] = []
    at = 0
    while at < len(row):
        symbol = next((symbol for symbol in CELL_OF if row.startswith(symbol, at)), None)
        if symbol is None:
            raise InvalidTaskError(
                f"unknown symbol {row[at : at + 2]!r} in row {y}, column {len(kinds)}; allowed: {ALLOWED}"
            )
        kinds.append(CELL_OF[symbol])
        at += len(symbol)
    return kinds


def _named(kind: Cell) -> str:
    return f"{'an' if kind == Cell.OBSTACLE else 'a'} {kind.name.lower()}"


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InvalidTaskError(message)
