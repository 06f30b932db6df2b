"""The figures of maps, as sprites of one cell, and shapes for all pictures.

`tools/draw_figures.py` makes the sprites from `figures.svg`, which the page also uses.
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
    """A pseudo-random number per cell, which varies the figures of one kind."""
    return crc32(bytes((x % 256, y % 256))) >> 8


def stroke(pen: ImageDraw.ImageDraw, points: Sequence[Point], width: float) -> None:
    """Draw a white line with round ends and joints on a mask."""
    wide = max(1, round(width))
    pen.line(points, fill=255, width=wide)
    for at in points:
        pen.ellipse(around(at, (wide - 1) / 2), fill=255)


@lru_cache(maxsize=256)
def draw_figure(name: str, cell: int) -> Image.Image:
    """A figure for cells of this size, with a margin of 0.4 cells for its shadow. Cached: do not draw on it."""
    side = cell + 2 * math.ceil(0.4 * cell)
    with Image.open(ART / f"{name}.png") as sprite:
        return sprite.convert("RGBA").resize((side, side), Image.Resampling.BOX)
