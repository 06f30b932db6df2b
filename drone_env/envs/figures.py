"""The figures of maps, as small pictures of one cell, and the shapes that all pictures share.

`tools/draw_figures.py` draws the figures as sprites from the sheet `figures.svg`, from which the page draws too.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from zlib import crc32

from PIL import Image, ImageDraw

ART = Path(__file__).parent / "art"
FIGURES = sorted(file.stem for file in ART.glob("*.png"))
Point = tuple[float, float]


def around(at: Point, across: float, down: float = 0.0) -> tuple[float, float, float, float]:
    """The box around a point: left, top, right, bottom in pixels."""
    return at[0] - across, at[1] - (down or across), at[0] + across, at[1] + (down or across)


def variety(x: int, y: int) -> int:
    """A number that differs from cell to cell, by which things of one kind look different."""
    return crc32(bytes((x % 256, y % 256))) >> 8


def stroke(pen: ImageDraw.ImageDraw, points: Sequence[Point], width: float, colour: str | int) -> None:
    """A line with round ends and joints."""
    wide = max(1, round(width))
    pen.line(points, fill=colour, width=wide)
    for at in points:
        pen.ellipse(around(at, (wide - 1) / 2), fill=colour)


@lru_cache(maxsize=256)
def draw_figure(name: str, cell: int) -> Image.Image:
    """A figure for cells of a size, with a margin of 0.4 cells for its shadow. Shared: do not draw on it."""
    side = cell + 2 * math.ceil(0.4 * cell)
    with Image.open(ART / f"{name}.png") as sprite:
        return sprite.convert("RGBA").resize((side, side), Image.Resampling.BOX)
