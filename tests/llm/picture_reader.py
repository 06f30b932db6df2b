"""What a picture of a map shows, read from its pixels alone."""

import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from drone_env.core.cells import Cell

LAWN, STREET = 0xCFDEBB, 0xFBFAF5
LOOKS = {
    Cell.DELIVERY: [0xF0A020],  # an orange box
    Cell.DELIVERED: [0x237A45],  # a green tick
    Cell.PAD: [0x2A93AD],  # a blue square
    Cell.OBSTACLE: [0xD0483B],  # a red and white barrier
    Cell.BUILDING: [0xBDBAB0, 0xB7BAB7, 0xD2CFC3, 0xCDD0CD],  # a grey roof
    Cell.TREE: [0x97C093, 0xA0C496],  # round green crowns
}
"""By what colours a kind of cell is told, the first that is there: what lies on top is looked for before the rest."""
JOINED = {
    Cell.OBSTACLE: [0xE6E3DF, 0xD8ACA6],  # grey with red hatching
    Cell.BUILDING: [0xE3DAC7, 0xDDD2BB, 0xE9E2D3],  # a beige roof
    Cell.TREE: [0xD3E5C3, 0xA3C791],  # pale green with darker crowns
}
"""The same where cells that touch each other are one shape."""
ENOUGH = 0.006
"""The share of a cell that a colour takes at least, where it belongs to what stands there."""


def read_picture(png: bytes, width: int, height: int) -> npt.NDArray[np.uint8]:
    """The kinds of cells, [y, x]; that below the drone is whatever can be seen of it.

    Args:
        png: The picture.
        width, height: Of the grid, in cells.
    """
    picture = np.array(Image.open(io.BytesIO(png)).convert("RGB")) @ np.array([1 << 16, 1 << 8, 1])
    joined = not (picture == LAWN).any()
    lawn, rim = picture == (STREET if joined else LAWN), len(picture) // 90
    # Its lawn, or its squares, reach beyond the outermost cells by a ninetieth of the picture's height. A few pixels of
    # that colour may also be in figures of the panel.
    (top, *_, bottom), (left, *_, right) = (np.flatnonzero(lawn.sum(axis) > 20) for axis in (1, 0))
    top, bottom, left, right = top + rim, bottom + 1 - rim, left + rim, right + 1 - rim
    rows, columns = np.linspace(top, bottom, height + 1).round(), np.linspace(left, right, width + 1).round()
    kinds = np.zeros((height, width), np.uint8)
    for y, x in np.ndindex(height, width):
        cell = picture[int(rows[y]) : int(rows[y + 1]), int(columns[x]) : int(columns[x + 1])]
        shares = {kind: max((cell == colour).mean() for colour in colours) for kind, colours in LOOKS.items()}
        kinds[y, x] = next((kind for kind, share in shares.items() if share > ENOUGH), Cell.ROAD)
        if joined and kinds[y, x] == Cell.ROAD:
            # Roofs stand a sixth of a cell higher.
            middle = cell[len(cell) // 6 : len(cell) * 2 // 3, len(cell) // 6 : -len(cell) // 6]
            kinds[y, x] = next((kind for kind, colours in JOINED.items() if np.isin(middle, colours).mean() > 0.2), 0)
    return kinds
