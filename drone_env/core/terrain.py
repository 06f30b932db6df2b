"""Terrain that is the same on every map of a task."""

from collections.abc import Collection
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import Cell

XY = tuple[int, int]
PLACED = (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD)
"""What a cell of terrain can be."""


@dataclass(frozen=True)
class Terrain:
    """The terrain of a task's maps, where it is fixed.

    Attributes:
        cells: The id of each cell, row by row.
        start: (x, y) of the start; None where the seed draws it.
        parcels: (x, y) of each parcel; empty where the seed draws them.
        attribution: Whose data it is, which whoever shows it has to say. It names no rule.
    """

    cells: bytes
    start: XY | None = None
    parcels: tuple[XY, ...] = ()
    attribution: str = field(default="", compare=False)

    def grid(self, width: int) -> npt.NDArray[np.uint8]:
        """uint8[height, width], read only."""
        return np.reshape(np.frombuffer(self.cells, np.uint8), (-1, width))

    def digest(self) -> str:
        """What tells it from any other: 64 hexadecimal digits."""
        return sha256(self.cells + repr((self.start, self.parcels)).encode()).hexdigest()

    def drawn_cells(self, width: int, closed: Collection[Cell]) -> list[int]:
        """The numbers of the cells that start, parcels and pads are drawn from: roads that reach each other.

        They are those of the piece of the fixed start or the first fixed parcel, else of the piece with most roads.

        Args:
            width: Of the grid.
            closed: The kinds that the drone cannot enter.
        """
        grid = self.grid(width)
        piece = pieces(np.isin(grid, list(closed)))
        roads = np.where(grid == Cell.ROAD, piece, 0)
        fixed = [stop for stop in (self.start, *self.parcels) if stop is not None]
        if fixed:
            number = int(piece[fixed[0][1], fixed[0][0]])
        else:
            number = 1 + int(np.bincount(roads.ravel(), minlength=2)[1:].argmax())
        return np.flatnonzero((roads == number).ravel() & (grid == Cell.ROAD).ravel()).tolist()


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
