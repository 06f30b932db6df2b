"""What stands on the map: the sheet `figures.svg`, from which the page draws too, as small pictures of one cell."""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree
from zlib import crc32

from PIL import Image, ImageChops, ImageDraw, ImageFilter

SHEET = Path(__file__).parent / "art" / "figures.svg"
Point = tuple[float, float]
_SVG = "{http://www.w3.org/2000/svg}"
_ROOT = ElementTree.parse(SHEET).getroot()
FIGURES = {figure.attrib["id"]: figure for figure in _ROOT.iterfind(f"{_SVG}svg")}
_FILTERS = {f"url(#{made.attrib['id']})": made for made in _ROOT.iterfind(f"{_SVG}filter")}


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
    """A figure for cells of a size, drawn larger and then reduced for smooth edges. Shared: do not draw on it."""
    fine = 4 if cell <= 100 else 2
    unit, side = cell * fine / 100, (cell + 2 * math.ceil(0.4 * cell)) * fine
    picture = Image.new("RGBA", (side, side))
    for part in FIGURES[name]:
        layer = Image.new("RGBA", picture.size)
        for shape in part if part.tag == f"{_SVG}g" else [part]:
            glaze = Image.new("RGBA", picture.size)  # as Pillow replaces what lies under translucent colours
            _draw(ImageDraw.Draw(glaze), shape, unit, side / 2)
            layer.alpha_composite(glaze)
        shadow = _FILTERS.get(part.get("filter", ""))
        if shadow is not None:
            picture.alpha_composite(_shadow(layer, shadow, unit))
        if shadow is None or shadow.find(f"{_SVG}feDropShadow") is not None:
            picture.alpha_composite(layer)
    return picture.reduce(fine)


def _shadow(layer: Image.Image, made: ElementTree.Element, unit: float) -> Image.Image:
    """The shadow of a layer by a filter, whose numbers stand in any of its steps."""
    of = {name: value for step in made for name, value in step.items()}
    cast = ImageChops.offset(layer.getchannel("A"), round(float(of["dx"]) * unit), round(float(of["dy"]) * unit))
    soft = cast.filter(ImageFilter.GaussianBlur(float(of["stdDeviation"]) * unit))
    shadow = Image.new("RGBA", layer.size, of["flood-color"])
    shadow.putalpha(soft.point([level * float(of["flood-opacity"]) for level in range(256)]))
    return shadow


def _draw(pen: ImageDraw.ImageDraw, shape: ElementTree.Element, unit: float, middle: float) -> None:
    """Draw one shape, whose numbers are hundredths of a cell from the middle."""
    kind, fill = shape.tag.removeprefix(_SVG), shape.get("fill", "")
    number = {name: float(shape.get(name, 0)) * unit for name in ("width", "height", "r", "rx", "stroke-width")}
    at = [middle + float(shape.get(name, 0)) * unit for name in ("x", "y", "cx", "cy")]
    points = [(middle + x * unit, middle + y * unit) for x, y in _pairs(shape.get("points", ""))]
    if kind == "rect":
        radius = min(number["rx"], number["width"] / 2 - 2, number["height"] / 2 - 2)
        box = (at[0], at[1], at[0] + number["width"], at[1] + number["height"])
        pen.rounded_rectangle(box, max(0, radius), fill)
    elif kind == "circle" and fill == "none":
        box = around((at[2], at[3]), number["r"] + number["stroke-width"] / 2)
        pen.arc(box, 0, 360, shape.attrib["stroke"], round(number["stroke-width"]) or 1)
    elif kind == "circle":
        pen.ellipse(around((at[2], at[3]), number["r"]), fill=fill)
    elif kind == "polygon":
        pen.polygon(points, fill=fill)
    else:
        stroke(pen, points, number["stroke-width"], shape.attrib["stroke"])


def _pairs(points: str) -> list[Point]:
    return [(float(x), float(y)) for x, y in (point.split(",") for point in points.split())]
