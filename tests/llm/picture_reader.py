"""What a picture of a map shows, read from its pixels alone."""

import io

import numpy as np
import numpy.typing as npt
from PIL import Image

from drone_env.core.cells import Cell

LAWN = 0xCFDEBB
LOOKS = {
    Cell.DELIVERY: [0xF0A020],  # an orange box
    Cell.DELIVERED: [0x237A45],  # a green tick
    Cell.PAD: [0x2A93AD],  # a blue square
    Cell.OBSTACLE: [0xD0483B],  # a red and white barrier
    Cell.BUILDING: [0xBDBAB0, 0xB7BAB7, 0xD2CFC3, 0xCDD0CD],  # a grey roof
    Cell.TREE: [0x97C093, 0xA0C496],  # round green crowns
}
"""By what colours a kind of cell is told, the first that is there: what lies on top is looked for before the rest."""
ENOUGH = 0.006
"""The share of a cell that a colour takes at least, where it belongs to what stands there."""


def read_picture(png: bytes, width: int, height: int) -> npt.NDArray[np.uint8]:
    """The kinds of cells, [y, x]; that below the drone is whatever can be seen of it.

    Args:
        png: The picture.
        width, height: Of the grid, in cells.
    """
    picture = np.array(Image.open(io.BytesIO(png)).convert("RGB")) @ np.array([1 << 16, 1 << 8, 1])
    lawn = np.argwhere(picture == LAWN)
    # The city lies on a lawn that reaches beyond its outermost cells by a ninetieth of the picture's height.
    (top, left), (bottom, right) = lawn.min(0) + len(picture) // 90, lawn.max(0) + 1 - len(picture) // 90
    rows, columns = np.linspace(top, bottom, height + 1).round(), np.linspace(left, right, width + 1).round()
    kinds = np.zeros((height, width), np.uint8)
    for y, x in np.ndindex(height, width):
        cell = picture[int(rows[y]) : int(rows[y + 1]), int(columns[x]) : int(columns[x + 1])]
        shares = {kind: max((cell == colour).mean() for colour in colours) for kind, colours in LOOKS.items()}
        kinds[y, x] = next((kind for kind, share in shares.items() if share > ENOUGH), Cell.ROAD)
    return kinds
