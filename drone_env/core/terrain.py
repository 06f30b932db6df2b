"""Fixed terrain. Each map of a task is the whole terrain or a window of it."""

import json
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import Cell
from drone_env.core.seeds import SPLITS

XY = tuple[int, int]
PLACED = (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD)
"""The kinds of cells in terrain."""
LETTERS = dict(zip(b".BTXP", PLACED, strict=True))
"""The letter of each kind in the files of `cities`."""
KIND_OF_LETTER = bytes(LETTERS.get(letter, letter) for letter in range(256))
MAX_WINDOWS_PER_SIDE = 32
"""Approximate limit: the tables for map generation grow with the number of windows."""


class Name(NamedTuple):
    """A name on a map: its text, its middle in cells, and the degrees clockwise of a street; None for a district."""

    text: str
    x: float
    y: float
    angle: int | None = None


class Window(NamedTuple):
    """A part of the terrain with the size of a map."""

    cells: bytes
    """The id of each cell, row by row."""
    drawn: list[int]
    """The numbers of the cells for random starts, parcels and pads."""
    pads: int
    """The number of pads."""


@dataclass(frozen=True)
class Terrain:
    """Fixed terrain of a task's maps.

    Attributes:
        cells: The id of each cell, row by row.
        width: Cells per row. If the terrain is larger than the task's maps, each map is a window of it.
        start: (x, y) of the start; None if it is random.
        parcels: (x, y) of each parcel; empty if they are random.
        attribution: Source of the data, which every picture must show. This and what follows does not affect rules.
        cell: Side of a cell in metres; None if unknown.
        names: Names of streets and districts.
    """

    cells: bytes = field(repr=False)
    width: int
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    attribution: str = field(default="", compare=False)
    cell: float | None = field(default=None, compare=False)
    names: tuple[Name, ...] = field(default=(), compare=False, repr=False)

    @property
    def height(self) -> int:
        """Number of rows."""
        return len(self.cells) // self.width

    def count(self, kind: Cell) -> int:
        """The number of cells of a kind."""
        return self.cells.count(kind)

    @property
    def fixed(self) -> list[XY]:
        """The fixed start and parcels."""
        return [stop for stop in (self.start, *self.parcels) if stop is not None]

    def grid(self) -> npt.NDArray[np.uint8]:
        """The cells as a read-only uint8[height, width]."""
        return np.reshape(np.frombuffer(self.cells, np.uint8), (-1, self.width))

    def digest(self) -> str:
        """A hash of everything that affects rules, 64 hex digits."""
        return sha256(self.cells + repr((self.width, self.start, self.parcels)).encode()).hexdigest()

    def corners(self, width: int, height: int) -> dict[str, list[XY]]:
        """The top left cells of the windows of each split. Windows of two splits share no cell.

        The side that fits more windows is cut: validation and test each get a fifth, but at least one window, and
        train gets the rest. If the terrain is as large as the window, all splits share it.

        Args:
            width: Width of a window.
            height: Height of a window.
        """
        sides, window = (self.width, self.height), (width, height)
        if sides == window:
            return {split: [(0, 0)] for split in SPLITS}
        across = int(sides[1] / height > sides[0] / width)
        held_out = max(window[across], sides[across] // 5)
        ends = [0, sides[across] - 2 * held_out, sides[across] - held_out, sides[across]]
        corners: dict[str, list[XY]] = {}
        for split, low, end in zip(SPLITS, ends, ends[1:], strict=False):
            areas = [(0, self.width), (0, self.height)]
            areas[across] = low, end
            columns, rows = (_along(area, side) for area, side in zip(areas, window, strict=True))
            corners[split] = [(x, y) for y in rows for x in columns]
        return corners

    def windows(self, corners: Iterable[XY], width: int, height: int, closed: Collection[Cell]) -> list[Window]:
        """The windows with these top left cells.

        Args:
            corners: The cells.
            width: Width of a window.
            height: Height of a window.
            closed: The kinds that the drone cannot enter.
        """
        city = self.grid()
        grids = np.stack([city[y : y + height, x : x + width] for x, y in corners])
        components = pieces(np.isin(grids, list(closed)))
        return [
            Window(grid.tobytes(), self._drawn(grid, labels), int((grid == Cell.PAD).sum()))
            for grid, labels in zip(grids, components, strict=True)
        ]

    def _drawn(self, grid: npt.NDArray[np.uint8], labels: npt.NDArray[np.int64]) -> list[int]:
        """The roads connected to the fixed start or the first fixed parcel, else the largest set of connected roads."""
        roads = np.where(grid == Cell.ROAD, labels, 0)
        numbers, counts = np.unique(roads[roads > 0], return_counts=True)
        if self.fixed:
            x, y = self.fixed[0]
            number = labels[y, x]
        else:
            number = numbers[counts.argmax()] if len(numbers) else 0
        return np.flatnonzero(roads == number).tolist() if number else []


def shipped_terrain(name: str) -> Terrain:
    """Load a file of `cities`: a line of JSON, and a row of letters in every other line."""
    text = (Path(__file__).with_name("cities") / f"{name}.txt").read_text("utf-8")
    about, *rows = text.splitlines()
    attribution, cell, names = json.loads(about)
    cells = "".join(rows).encode().translate(KIND_OF_LETTER)
    return Terrain(cells, len(rows[0]), None, (), attribution, cell, tuple(Name(*name) for name in names))


def _along(area: tuple[int, int], side: int) -> range:
    """The first cells of windows: a quarter of a side apart, or more to limit their number."""
    first, last = area[0], area[1] - side
    return range(first, last + 1, max(1, side // 4, -(-(last - first) // MAX_WINDOWS_PER_SIDE)))


def pieces(closed: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Label the connected components of open cells.

    Args:
        closed: bool[..., height, width], one grid or more.

    Returns:
        int64[..., height, width], a positive number per component; 0 for closed cells.
    """
    first = ~closed
    first[..., 1:] &= closed[..., :-1]
    # Each run of open cells in a row gets a number; then runs that touch in adjacent rows are joined (union-find).
    runs = np.where(closed, 0, np.reshape(first.cumsum(), closed.shape))
    above, below = runs[..., :-1, :], runs[..., 1:, :]
    touch = (above > 0) & (below > 0)
    parent = list(range(runs.max(initial=0) + 1))

    def root(run: int) -> int:
        while parent[run] != run:
            parent[run] = run = parent[parent[run]]
        return run

    touching = np.unique(above[touch] * len(parent) + below[touch])
    for one, other in zip(*(side.tolist() for side in np.divmod(touching, len(parent))), strict=True):
        parent[root(one)] = root(other)
    return np.array([root(run) for run in parent])[runs]
