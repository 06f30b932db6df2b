"""The ground of a large map or of a real place: cells of one kind that touch each other are one block, wood or area."""

import math

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageChops, ImageDraw, ImageFilter

from drone_env.core.cells import Cell
from drone_env.core.tasks import TaskConfig
from drone_env.core.terrain import pieces
from drone_env.envs.figures import around, variety

MOST_SIGNS = 400
"""Cells of a map: on larger ones, a sign for each says less than what they make together."""
STREET, CLOSED, HATCH, WOOD, CROWN = "#FBFAF5", "#E6E3DF", "#D8ACA6", "#D3E5C3", "#A3C791"
SHADE, WALL, EDGE, ROOFS = "#DAD5C9", "#C0B59F", "#A99F8B", ("#E3DAC7", "#DDD2BB", "#E9E2D3")
HEIGHT, SHADOW = 0.16, 0.17
"""In cells: how far a roof stands above the ground, and how far its shadow lies to the right and below."""
ROUND, LEVEL = 0.18, 166
"""How round outlines are, in cells, and the level that lets shapes which meet at a corner alone stay apart."""
FINE_CELL = 8
"""Pixels: smaller cells show neither their trees nor their grid."""
INNER = 232
"""The level that the middle of a single cell exceeds."""
GRID = 24
"""How strong the lines of the grid are, of 255."""


def is_joined(task: TaskConfig) -> bool:
    """Whether the maps of a task are drawn by blocks."""
    return task.width * task.height > MOST_SIGNS or task.attribution != ""


def draw_blocks(grid: npt.NDArray[np.uint8], unit: int, rim: int, fine: int, street: str = STREET) -> Image.Image:
    """The cells of a map but for its pads.

    Args:
        grid: uint8[height, width], cell ids.
        unit: Side of a cell in pixels.
        rim: Pixels of street around the cells.
        fine: How many of these pixels, along a side, make one of the picture that is shown.
        street: The colour of what is open.

    Returns:
        RGB, (width * unit + 2 * rim) by (height * unit + 2 * rim) pixels.
    """
    rows, columns = grid.shape
    drawn = Image.new("RGB", (columns * unit + 2 * rim, rows * unit + 2 * rim), street)

    def soft(cells: npt.NDArray[np.bool_]) -> Image.Image:
        margin = -(-rim // unit)
        levels = Image.fromarray(np.pad(cells, margin).astype(np.uint8) * 255)
        levels = levels.resize((levels.width * unit, levels.height * unit), Image.Resampling.NEAREST)
        edge = margin * unit - rim
        blurred = levels.filter(ImageFilter.GaussianBlur(ROUND * unit))
        return blurred.crop((edge, edge, edge + drawn.width, edge + drawn.height))

    # The rise of the levels across an outline, from one pixel of the shown picture to the next.
    rise = 255 * fine / (ROUND * unit * math.sqrt(2 * math.pi))
    edge = min(LEVEL + round(rise), INNER)

    def lay(colour: str, levels: Image.Image, right: float = 0, down: float = 0, most: int = 255) -> None:
        mask = levels.point([255 * (LEVEL <= level <= most) for level in range(256)])
        drawn.paste(colour, mask=ImageChops.offset(mask, round(right * unit), round(down * unit)))

    closed, wood, building = (soft(grid == kind) for kind in (Cell.OBSTACLE, Cell.TREE, Cell.BUILDING))
    lay(CLOSED, closed)
    lay(HATCH, ImageChops.multiply(closed, _hatching(drawn, unit, fine)))
    lay(HATCH, closed, most=edge)
    lay(WOOD, wood)
    if unit >= FINE_CELL * fine:
        pen = ImageDraw.Draw(drawn)
        for y, x in np.argwhere(grid == Cell.TREE).tolist():
            _draw_crowns(pen, x, y, unit, rim)
    lay(CROWN, wood, most=edge)
    lay(SHADE, building, SHADOW, SHADOW)
    lay(WALL, building)
    block = pieces(grid != Cell.BUILDING)
    # The first cell of a block says the tone of its roof.
    _, first, of = np.unique(block, return_index=True, return_inverse=True)
    tone_of = np.array([variety(at % columns, at // columns) % len(ROOFS) for at in first.tolist()])
    tones = tone_of[of.reshape(grid.shape)]
    for tone, colour in enumerate(ROOFS):
        lay(colour, soft((block > 0) & (tones == tone)), down=-HEIGHT)
    lay(EDGE, building, down=-HEIGHT, most=edge)
    if unit >= FINE_CELL * fine:
        down, across = np.ogrid[: rows * unit + 1, : columns * unit + 1]
        lines = np.where((down % unit < fine) | (across % unit < fine), GRID, 0)
        drawn.paste(EDGE, (rim, rim), Image.fromarray(lines.astype(np.uint8)))
    return drawn


def _hatching(on: Image.Image, unit: int, fine: int) -> Image.Image:
    """Lines from the top left to the bottom right, one picture's pixel wide."""
    pace = max(3 * fine, unit // 2)
    rows, columns = (np.arange(side, dtype=np.int16) for side in (on.height, on.width))
    lines = np.subtract.outer(rows, columns) % pace < fine
    return Image.fromarray(lines.astype(np.uint8) * 255)


def _draw_crowns(pen: ImageDraw.ImageDraw, x: int, y: int, unit: int, rim: int) -> None:
    """Three trees in a cell, not two cells alike."""
    some = variety(x, y)
    for i in range(3):
        angle, radius = some % 63 / 10 + 2.1 * i, (0.12 + 0.02 * ((some >> 3 * i) % 4)) * unit
        middle = x + 0.5 + 0.21 * math.cos(angle), y + 0.5 + 0.21 * math.sin(angle)
        pen.ellipse(around((rim + middle[0] * unit, rim + middle[1] * unit), radius), fill=CROWN)
