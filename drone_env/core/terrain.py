"""Terrain that is the same on every map of a task, or of which each map is a window."""

from collections.abc import Collection
from dataclasses import dataclass, field
from hashlib import sha256
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import Cell
from drone_env.core.seeds import SPLITS

XY = tuple[int, int]
PLACED = (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD)
"""What a cell of terrain can be."""
MOST_ALONG = 32
"""Windows along a side, about: what maps are drawn from grows with their number."""


class Window(NamedTuple):
    """A piece of terrain as large as a map."""

    cells: bytes
    """The id of each cell, row by row."""
    drawn: list[int]
    """The numbers of the cells that start, parcels and pads are drawn from."""
    pads: int
    """How many stand there already."""


@dataclass(frozen=True)
class Terrain:
    """The terrain of a task's maps, where it is fixed.

    Attributes:
        cells: The id of each cell, row by row.
        width: Cells along a row. Where the terrain is larger than the task's maps, each map is a window of it.
        start: (x, y) of the start; None where the seed draws it.
        parcels: (x, y) of each parcel; empty where the seed draws them.
        attribution: Whose data it is, which whoever shows it has to say. It names no rule.
    """

    cells: bytes
    width: int
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    attribution: str = field(default="", compare=False)

    @property
    def height(self) -> int:
        """Rows."""
        return len(self.cells) // self.width

    @property
    def fixed(self) -> list[XY]:
        """The start and the parcels that the seed does not draw."""
        return [stop for stop in (self.start, *self.parcels) if stop is not None]

    def grid(self) -> npt.NDArray[np.uint8]:
        """uint8[height, width], read only."""
        return np.reshape(np.frombuffer(self.cells, np.uint8), (-1, self.width))

    def digest(self) -> str:
        """What tells it from any other: 64 hexadecimal digits."""
        return sha256(self.cells + repr((self.width, self.start, self.parcels)).encode()).hexdigest()

    def corners(self, width: int, height: int) -> dict[str, list[XY]]:
        """The top left cells of the windows of each split, of which those of two splits share no cell.

        The terrain is cut across the side along which more windows lie: a fifth of it for each of validation and test,
        or the side of one window where that is more, and the rest for train. Of a terrain as large as the window there
        is one for all.

        Args:
            width: Of a window.
            height: Of a window.
        """
        sides, window = (self.width, self.height), (width, height)
        if sides == window:
            return {split: [(0, 0)] for split in SPLITS}
        across = int(sides[1] / height > sides[0] / width)
        kept = max(window[across], sides[across] // 5)
        ends = [0, sides[across] - 2 * kept, sides[across] - kept, sides[across]]
        corners: dict[str, list[XY]] = {}
        for split, low, end in zip(SPLITS, ends, ends[1:], strict=False):
            areas = [(0, self.width), (0, self.height)]
            areas[across] = low, end
            columns, rows = (_along(area, side) for area, side in zip(areas, window, strict=True))
            corners[split] = [(x, y) for y in rows for x in columns]
        return corners

    def drawn_cells(self, grid: npt.NDArray[np.uint8], closed: Collection[Cell]) -> list[int]:
        """The numbers of the cells that start, parcels and pads are drawn from: roads that reach each other.

        They are those of the piece of the fixed start or the first fixed parcel, else of the piece with most roads.

        Args:
            grid: The terrain, or a window of it.
            closed: The kinds that the drone cannot enter.
        """
        piece = pieces(np.isin(grid, list(closed)))
        roads = np.where(grid == Cell.ROAD, piece, 0)
        if self.fixed:
            x, y = self.fixed[0]
            number = int(piece[y, x])
        else:
            number = 1 + int(np.bincount(roads.ravel(), minlength=2)[1:].argmax())
        return np.flatnonzero((roads == number).ravel() & (grid == Cell.ROAD).ravel()).tolist()


def _along(area: tuple[int, int], side: int) -> range:
    """Where windows begin: a quarter of their side apart, or farther where there would be too many."""
    first, last = area[0], area[1] - side
    return range(first, last + 1, max(1, side // 4, -(-(last - first) // MOST_ALONG)))


def pieces(closed: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """int64[height, width]: which piece each cell belongs to, from 1; 0 for a closed cell.

    A drone gets from each cell of a piece to each other without entering a closed cell, and to no other piece.
    """
    walled = np.pad(closed, 1, constant_values=True)
    width = walled.shape[1]
    piece: list[int] = np.where(walled, 0, -1).ravel().tolist()
    found = 0
    for start in np.flatnonzero(~walled).tolist():
        if piece[start] > 0:
            continue
        found += 1
        piece[start] = found
        pending = [start]
        while pending:
            at = pending.pop()
            for to in (at - width, at - 1, at + 1, at + width):
                if piece[to] < 0:
                    piece[to] = found
                    pending.append(to)
    return np.reshape(np.array(piece), walled.shape)[1:-1, 1:-1]
