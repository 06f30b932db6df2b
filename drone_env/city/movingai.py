"""Maps of the MovingAI benchmark: text files with one sign for each cell.

The format: https://movingai.com/benchmarks/formats.html (Sturtevant, "Benchmarks for Grid-Based Pathfinding", IEEE
Transactions on Computational Intelligence and AI in Games 4(2), 2012).
"""

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError
from drone_env.files import read_file

CELL_OF = {
    ".": Cell.ROAD,
    "G": Cell.ROAD,
    "S": Cell.TREE,
    "@": Cell.OBSTACLE,
    "O": Cell.OBSTACLE,
    "T": Cell.OBSTACLE,
    "W": Cell.OBSTACLE,
}
"""What is passable, swamp (passable too, and dearer where a task has trees so), and what cannot be entered."""
MAX_FILE = 8 << 20
"""Bytes: room for 2,800 x 2,800 cells."""
HEAD = re.compile(r"type octile\s+height (\d{1,5})\s+width (\d{1,5})\s+map[ \t]*\n")


def read_movingai(path: Path) -> npt.NDArray[np.uint8]:
    """The cells of a `.map` file: uint8[height, width], ids of kinds.

    Raises:
        InvalidValueError: if it is none; the message says why.
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
