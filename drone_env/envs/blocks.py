"""The ground of large maps and real places: adjacent cells of one kind are drawn as one shape."""

import math

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageChops, ImageDraw, ImageFilter

from drone_env.core.cells import Cell
from drone_env.core.tasks import TaskConfig
from drone_env.envs.figures import around, variety

MAX_FIGURE_CELLS = 400
"""Cells of the largest map with one figure per cell."""
STREET, CLOSED, HATCH, WOOD, CROWN = "#FBFAF5", "#E6E3DF", "#D8ACA6", "#D3E5C3", "#A3C791"
SHADE, WALL, ROOF = "#DAD5C9", "#C0B59F", "#E3DAC7"
HEIGHT, SHADOW = 0.16, 0.17
"""In cells: the height of a roof above the ground, and the offset of its shadow to the right and down."""
ROUND, LEVEL = 0.18, 166
"""Blur of the outlines in cells, and the threshold that separates shapes that only touch at a corner."""
MIN_CROWN_CELL = 8
"""Side in pixels of the smallest cell with trees."""


def is_joined(task: TaskConfig) -> bool:
    """Whether the maps of a task are drawn by blocks."""
    return task.width * task.height > MAX_FIGURE_CELLS or task.attribution != ""


def draw_blocks(grid: npt.NDArray[np.uint8], unit: int, rim: int, fine: int, street: str = STREET) -> Image.Image:
    """Draw the cells of a map, except its pads.

    Args:
        grid: uint8[height, width], cell ids.
        unit: Side of a cell in pixels.
        rim: Pixels of street around the cells.
        fine: Supersampling factor: the caller reduces the picture by it.
        street: Colour of open cells.

    Returns:
        RGB, (width * unit + 2 * rim) by (height * unit + 2 * rim) pixels.
    """
    rows, columns = grid.shape
    picture = Image.new("RGB", (columns * unit + 2 * rim, rows * unit + 2 * rim), street)

    def outline(kind: Cell) -> Image.Image:
        margin = -(-rim // unit)
        levels = Image.fromarray(np.pad(grid == kind, margin).astype(np.uint8) * 255)
        levels = levels.resize((levels.width * unit, levels.height * unit), Image.Resampling.NEAREST)
        edge = margin * unit - rim
        blurred = levels.filter(ImageFilter.GaussianBlur(ROUND * unit))
        cropped = blurred.crop((edge, edge, edge + picture.width, edge + picture.height))
        return cropped.point([255 * (level >= LEVEL) for level in range(256)])

    def fill(colour: str, mask: Image.Image, right: float = 0, down: float = 0) -> None:
        picture.paste(colour, mask=ImageChops.offset(mask, round(right * unit), round(down * unit)))

    closed, wood, building = map(outline, (Cell.OBSTACLE, Cell.TREE, Cell.BUILDING))
    fill(CLOSED, closed)
    fill(HATCH, ImageChops.multiply(closed, _hatching(picture, unit, fine)))
    fill(WOOD, wood)
    if unit >= MIN_CROWN_CELL * fine:
        pen = ImageDraw.Draw(picture)
        for y, x in np.argwhere(grid == Cell.TREE).tolist():
            _draw_crowns(pen, x, y, unit, rim)
    fill(SHADE, building, SHADOW, SHADOW)
    fill(WALL, building)
    fill(ROOF, building, down=-HEIGHT)
    return picture


def _hatching(on: Image.Image, unit: int, fine: int) -> Image.Image:
    """A mask of diagonal lines, one pixel of the reduced picture wide."""
    spacing = max(3 * fine, unit // 2)
    rows, columns = (np.arange(side, dtype=np.int16) for side in (on.height, on.width))
    lines = np.subtract.outer(rows, columns) % spacing < fine
    return Image.fromarray(lines.astype(np.uint8) * 255)


def _draw_crowns(pen: ImageDraw.ImageDraw, x: int, y: int, unit: int, rim: int) -> None:
    """Draw three trees in a cell, varied from cell to cell."""
    number = variety(x, y)
    for i in range(3):
        angle, radius = number % 63 / 10 + 2.1 * i, (0.12 + 0.02 * ((number >> 3 * i) % 4)) * unit
        middle = x + 0.5 + 0.21 * math.cos(angle), y + 0.5 + 0.21 * math.sin(angle)
        pen.ellipse(around((rim + middle[0] * unit, rim + middle[1] * unit), radius), fill=CROWN)
