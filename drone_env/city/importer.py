"""A city from an extract of OpenStreetMap, or from a map of the MovingAI benchmark.

The format of the latter: https://movingai.com/benchmarks/formats.html (Sturtevant, "Benchmarks for Grid-Based
Pathfinding", IEEE Transactions on Computational Intelligence and AI in Games 4(2), 2012).
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.city.city_file import MAX_SIDE, MIN_SIDE, BBox, City
from drone_env.city.openstreetmap import ATTRIBUTION, LICENCE, Extract, Found, Layer, extent, layers, read_extract
from drone_env.city.raster import (
    MAX_CELL,
    MIN_CELL,
    GridProjection,
    paint_area,
    paint_line,
    projection_of,
    water_beside,
)
from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError
from drone_env.files import read_file

FINE = 16
"""Samples along the side of a cell: one a metre, where nothing else is said."""
CELL_OF = {
    ".": Cell.ROAD,
    "G": Cell.ROAD,
    "S": Cell.TREE,
    "@": Cell.OBSTACLE,
    "O": Cell.OBSTACLE,
    "T": Cell.OBSTACLE,
    "W": Cell.OBSTACLE,
}
"""Passable terrain, swamp (passable, and as expensive as a task's trees) and impassable terrain."""
MAX_FILE = 8 << 20
"""Bytes: room for 2,800 x 2,800 cells."""
HEAD = re.compile(r"type octile\s+height (\d{1,5})\s+width (\d{1,5})\s+map[ \t]*\n")


class Imported(NamedTuple):
    """A city, and what became of the file."""

    city: City
    whole: tuple[int, int] | None
    """Columns and rows of the file, where no box was named; None where one was."""
    outside: int = 0
    """Things with a key that layers ask for, dropped as they lie outside."""
    broken: int = 0
    """Things that were dropped as nodes are missing or rings do not close."""


def import_city(path: Path, bbox: BBox | None = None, cell: float = 16.0, size: tuple[int, int] = (64, 64)) -> Imported:
    """The city in a file. Equal files give equal cities.

    Args:
        path: An extract of OpenStreetMap (.osm.pbf or .osm), or a map of the MovingAI benchmark (.map).
        bbox: West, south, east, north in degrees; without one, the middle of the file.
        cell: Metres along the side of a cell; of no meaning for a .map.
        size: The most columns and rows.

    Raises:
        InvalidValueError: if the file cannot be read, holds nothing there, or the box more cells than `size` allows.
        MissingPackageError: if the extra `city` is not installed.
        OSError: if the file cannot be opened.
    """
    if not (MIN_SIDE <= min(size) and max(size) <= MAX_SIDE):
        raise InvalidValueError(
            f"--size must be {MIN_SIDE}x{MIN_SIDE} to {MAX_SIDE}x{MAX_SIDE}, got {size[0]}x{size[1]}"
        )
    if not MIN_CELL <= cell <= MAX_CELL:
        raise InvalidValueError(f"--cell must be {MIN_CELL:g} to {MAX_CELL:g} metres, got {cell:g}")
    if path.is_dir():
        raise InvalidValueError(f"{path} is a folder")
    if path.suffix == ".map":
        if bbox is not None:
            raise InvalidValueError("--bbox is in degrees, and a .map has none: its middle becomes the city")
        return _middle(path, size)
    covered = extent(path)
    try:
        projection = projection_of(bbox or covered, cell, size, middle=bbox is None)
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    extract = read_extract(path, projection)
    if not any(found.things for found in extract.layers.values()):
        west, south, east, north = covered
        raise InvalidValueError(f"{path}: nothing of the layers lies there; it covers {west} {south} {east} {north}")
    city = City(_terrain(extract, projection), ATTRIBUTION, LICENCE, path.name, cell, projection.bbox)
    whole = None if bbox else projection_of(covered, cell, (1 << 30, 1 << 30))
    return Imported(city, whole and (whole.columns, whole.rows), extract.outside, extract.broken)


def read_movingai(path: Path) -> npt.NDArray[np.uint8]:
    """The cells of a `.map` file: uint8[height, width], ids of kinds.

    Raises:
        InvalidValueError: if it is not one.
        OSError: if it cannot be read.
    """

    def require(holds: bool, message: str) -> None:
        if not holds:
            raise InvalidValueError(f"{path}: {message}")

    text = read_file(path, MAX_FILE).decode("ascii", errors="replace").replace("\r\n", "\n")
    head = HEAD.match(text)
    if head is None:
        begins = "`type octile`, `height H`, `width W`, `map`, a line each"
        raise InvalidValueError(
            f"{path}: not a map of the MovingAI benchmark, which begins with {begins}; got {text[:40]!r}"
        )
    height, width = int(head[1]), int(head[2])
    rows = text[head.end() :].split("\n")
    while rows and not rows[-1]:
        rows.pop()
    require(len(rows) == height, f"height is {height}, and there are {len(rows)} rows")
    for y, row in enumerate(rows):
        require(len(row) == width, f"width is {width}, and row {y} has {len(row)} cells")
        unknown = next((x for x, sign in enumerate(row) if sign not in CELL_OF), None)
        if unknown is not None:
            allowed = " ".join(CELL_OF)
            require(False, f"unknown sign {row[unknown]!r} in row {y}, column {unknown}; allowed: {allowed}")
    return np.array([[CELL_OF[sign] for sign in row] for row in rows], np.uint8).reshape(height, width)


def _middle(path: Path, size: tuple[int, int]) -> Imported:
    """The middle of a map of the MovingAI benchmark."""
    grid = read_movingai(path)
    height, width = grid.shape
    columns, rows = min(width, size[0]), min(height, size[1])
    left, top = (width - columns) // 2, (height - rows) // 2
    middle = np.ascontiguousarray(grid[top : top + rows, left : left + columns])
    return Imported(City(middle, source=path.name), (width, height))


def _terrain(extract: Extract, projection: GridProjection) -> npt.NDArray[np.uint8]:
    """The kind of each cell: that of the first layer that claims it."""
    grid = np.full((projection.rows, projection.columns), Cell.ROAD, np.uint8)
    free = np.ones(grid.shape, np.bool_)
    for layer in layers():
        claimed = _claims(layer, extract.layers[layer.name], projection) & free
        free &= ~claimed
        grid[claimed] = layer.kind
    return grid


def _claims(layer: Layer, found: Found, projection: GridProjection) -> npt.NDArray[np.bool_]:
    """bool[rows, columns]: the cells that a layer claims."""
    claimed = np.zeros((projection.rows, projection.columns), np.bool_)
    if found.areas or found.lines:
        covered = np.zeros((projection.rows * FINE, projection.columns * FINE), np.bool_)
        for rings in found.areas:
            paint_area(covered, [ring * FINE for ring in rings])
        for line, width in found.lines:
            paint_line(covered, line * FINE, width / projection.cell * FINE)
        samples = np.reshape(covered, (projection.rows, FINE, projection.columns, FINE)).sum(axis=(1, 3))
        claimed |= samples >= layer.share * FINE**2
    if found.coasts:
        claimed |= water_beside(found.coasts, claimed.shape)
    for x, y in found.points:
        claimed[int(y), int(x)] = True
    return claimed
