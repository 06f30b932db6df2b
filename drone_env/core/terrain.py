"""Terrain that is the same on every map of a task, or of which each map is a window."""

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
MOST_ALONG = 32
"""Windows along a side, about: what maps are drawn from grows with their number."""


class Window(NamedTuple):
    """A piece of terrain as large as a map."""

    cells: bytes
    """The id of each cell, row by row."""
    drawn: list[int]
    """The numbers of the cells that start, parcels and pads are drawn from."""
    pads: int
    """The number of pads."""


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

    cells: bytes = field(repr=False)
    width: int
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    attribution: str = field(default="", compare=False)

    @property
    def height(self) -> int:
        """Rows."""
        return len(self.cells) // self.width

    def count(self, kind: Cell) -> int:
        """The number of cells of a kind."""
        return self.cells.count(kind)

    @property
    def fixed(self) -> list[XY]:
        """The start and the parcels that the seed does not draw."""
        return [stop for stop in (self.start, *self.parcels) if stop is not None]

    def grid(self) -> npt.NDArray[np.uint8]:
        """uint8[height, width], read only."""
        return np.reshape(np.frombuffer(self.cells, np.uint8), (-1, self.width))

    def digest(self) -> str:
        """A hash of everything but its attribution: 64 hexadecimal digits."""
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

    def windows(self, corners: Iterable[XY], width: int, height: int, closed: Collection[Cell]) -> list[Window]:
        """The windows with these top left cells.

        Args:
            corners: The cells.
            width: Of a window.
            height: Of a window.
            closed: The kinds that the drone cannot enter.
        """
        city = self.grid()
        grids = np.stack([city[y : y + height, x : x + width] for x, y in corners])
        reached = pieces(np.isin(grids, list(closed)))
        return [
            Window(grid.tobytes(), self._drawn(grid, piece), int((grid == Cell.PAD).sum()))
            for grid, piece in zip(grids, reached, strict=True)
        ]

    def _drawn(self, grid: npt.NDArray[np.uint8], piece: npt.NDArray[np.int64]) -> list[int]:
        """The roads of the piece of the fixed start or the first fixed parcel, else of the piece with most of them."""
        roads = np.where(grid == Cell.ROAD, piece, 0)
        numbers, counts = np.unique(roads[roads > 0], return_counts=True)
        if self.fixed:
            x, y = self.fixed[0]
            number = piece[y, x]
        else:
            number = numbers[counts.argmax()] if len(numbers) else 0
        return np.flatnonzero(roads == number).tolist() if number else []


def shipped_terrain(name: str) -> Terrain:
    """The terrain in a file of `cities`: whose data it is in the first line, then a row of letters in each."""
    attribution, *rows = (Path(__file__).with_name("cities") / f"{name}.txt").read_text("utf-8").split("\n")
    return Terrain("".join(rows).encode().translate(KIND_OF_LETTER), len(rows[0]), attribution=attribution)


def terrain_text(grid: npt.NDArray[np.uint8], attribution: str) -> str:
    """The text of such a file."""
    letters = {kind: chr(letter) for letter, kind in LETTERS.items()}
    return "\n".join([attribution, *("".join(map(letters.__getitem__, row)) for row in grid.tolist()), ""])


def _along(area: tuple[int, int], side: int) -> range:
    """Where windows begin: a quarter of their side apart, or farther where there would be too many."""
    first, last = area[0], area[1] - side
    return range(first, last + 1, max(1, side // 4, -(-(last - first) // MOST_ALONG)))


def pieces(closed: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Which piece each cell belongs to.

    A drone gets from each cell of a piece to each other without entering a closed cell, and to no other piece.

    Args:
        closed: bool[..., height, width], one grid or more.

    Returns:
        int64[..., height, width], numbers above 0 that no two pieces share; 0 for a closed cell.
    """
    begins = ~closed
    begins[..., 1:] &= closed[..., :-1]
    # The cells between two closed ones in a row are numbered alike; then those join that touch from row to row.
    runs = np.where(closed, 0, np.reshape(begins.cumsum(), closed.shape))
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
