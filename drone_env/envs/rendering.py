"""A mission as a picture: the city from above, and beside it a panel that tells how the flight stands."""

import math
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageChops, ImageDraw, ImageFilter, ImageFont

from drone_env.core.actions import Outcome
from drone_env.core.cells import Cell
from drone_env.core.grid_generator import generate_city_map
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError

# fmt: off
PALETTE = {
    "backdrop": "#DCE6E6", "shadow": "#33474E", "card": "#FDFCF8", "rail": "#E7EBE5", "tint": "#F1F4EE",
    "ink": "#24343B", "muted": "#78878B", "good": "#55A27A", "fair": "#E3A94B", "low": "#DB6058", "flight": "#6C83C6",
    "lawn0": "#CFDEBB", "lawn1": "#CBDAB5", "lawn2": "#D3E0BF", "shrub": "#B4CB9E",
    "kerb": "#DDD8C6", "street": "#F7F4EA", "marking": "#DCD5C2", "plot": "#EAE3D5", "plot_edge": "#D6CDBA",
    "roof0": "#D4886B", "roof1": "#7F9CB0", "roof2": "#E0BC84", "roof3": "#8FB0A4", "roof4": "#B796A8",
    "roof5": "#C9775F", "window": "#F6E7BE", "glass": "#CFE3EA", "metal": "#EEF0EE", "metal_dark": "#A9B4B8",
    "park": "#BCD3A1", "leaf0": "#74AA76", "leaf1": "#88B26C",
    "barrier": "#E8824A", "plank": "#FFF8EC", "lamp": "#F7C65B", "shade": "#24343B30",
    "box": "#DDB07C", "box_front": "#C4915D", "box_edge": "#A87747", "tape": "#F3DDB5", "label": "#FBF6EA",
    "drop": "#FFFDF6", "drop_edge": "#E3C39A", "done": "#4E9F74", "done_pale": "#DCEBD8", "done_edge": "#B5D5BC",
    "charger": "#4F9AA8", "charger_edge": "#3A7E8D", "bolt": "#FFE08A", "white": "#FFFFFF",
    "hull": "#2E3D4D", "hull_light": "#53687E", "rotor": "#E4EFF6C8", "rotor_rim": "#4C6075D0", "blade": "#2E3D4D90",
    "trail": "#4C63B6", "target": "#E0525F", "barred": "#C65B55",
}

# Drawings around the middle of a cell, in hundredths of a cell: shape, colour and numbers. `lift` (reach, blur, strength
# in percent, steps) puts the shadow of all since the last `lift` or `flat` below it.
ART = {
    "building": "box plot_edge -46 -46 46 46 9; box plot -44 -44 44 44 8; flat; box roof-32 -33 -40 33 36 3;"
                "box window -27 26 -21 32 1; box window -15 26 -9 32 1; box window -3 26 3 32 1;"
                "box window 9 26 15 32 1; box window 21 26 27 32 1; lift 17 2 32 6;"
                "box roof+28 -33 -40 33 23 3; box roof -29 -36 29 19 2;",
    "roof_hip": "poly roof+14 -29 -36 29 -36 12 -8 -12 -8; poly roof-12 -29 19 29 19 12 -8 -12 -8;"
                "poly roof-5 29 -36 29 19 12 -8; line roof+30 3 -12 -8 12 -8; box roof-35 6 -28 14 -18 1",
    "roof_flat": "box roof-14 -29 -36 29 -30 0; box roof-22 -20 -20 -2 -6 2; box metal -22 -22 -4 -8 2;"
                 "oval metal_dark -13 -15 5; box roof-22 4 -20 22 -6 2; box metal 2 -22 20 -8 2;"
                 "oval metal_dark 11 -15 5; box roof-22 -22 2 -6 12 2; box roof+20 8 0 22 12 2",
    "roof_garden": "box roof-10 -25 -31 25 14 3; box park -21 -27 2 10 3; oval leaf0 -13 -18 6; oval leaf0 -7 -4 5;"
                   "oval leaf0 -15 3 5; box glass 7 -25 21 -16 1; box glass 7 -12 21 -3 1; box glass 7 1 21 10 1",
    "roof_tower": "box roof-28 -16 -22 24 15 2; box roof+32 -21 -29 18 8 2; box roof+12 -18 -26 15 5 2;"
                  "oval roof-18 -1 -10 10; oval metal -2 -11 9; oval metal_dark -2 -11 4",
    "tree0": "oval park 0 0 46; flat; crown leaf0 -13 -12 23; crown leaf1 17 4 19; crown leaf0 -8 21 16; lift 11 2 30 5",
    "tree1": "oval park 0 0 46; flat; crown leaf1 0 -2 33; lift 11 2 30 5",
    "tree2": "oval park 0 0 46; flat; crown leaf0 12 -14 22; crown leaf0 -18 0 18; crown leaf1 10 20 17; lift 11 2 30 5",
    "tree3": "oval park 0 0 46; flat; crown leaf0 -12 5 26; crown leaf1 19 -13 17; crown leaf1 20 20 12; lift 11 2 30 5",
    "obstacle": "line hull_light 5 -29 30 -25 -20 -21 30; line hull_light 5 21 30 25 -20 29 30;"
                "box plank -41 -22 41 -3 3; poly barrier -28 -22 -17 -22 -26 -3 -37 -3;"
                "poly barrier -9 -22 2 -22 -7 -3 -18 -3; poly barrier 10 -22 21 -22 12 -3 1 -3;"
                "poly barrier 29 -22 40 -22 31 -3 20 -3; box plank -41 4 41 23 3;"
                "poly barrier -28 4 -17 4 -26 23 -37 23; poly barrier -9 4 2 4 -7 23 -18 23;"
                "poly barrier 10 4 21 4 12 23 1 23; poly barrier 29 4 40 4 31 23 20 23; box shade -41 -6 41 -3 1;"
                "box shade -41 20 41 23 1; oval lamp-25 -25 -28 8; oval lamp -26 -29 6; oval lamp-25 25 -28 8;"
                "oval lamp 24 -29 6; lift 9 2 34 5",
    "pad": "box charger_edge -42 -42 42 42 14; box charger -38 -38 38 38 11; ring white 0 0 31 3;"
           "poly bolt 6 -25 -15 4 -2 4 -7 25 15 -6 2 -6",
    "parcel": "oval drop_edge 0 0 43; oval drop 0 0 39; flat; box box_edge -28 -30 28 30 4; box box -26 -28 26 8 2;"
              "box box_front -26 8 26 28 2; box tape -6 -28 6 8 0; box tape-12 -6 8 6 17 0; box label 10 13 22 23 1;"
              "box box_edge+40 12 15 20 16 0; box box_edge+40 12 18 18 19 0; lift 12 2 34 5",
    "delivered": "oval done_edge 0 0 43; oval done_pale 0 0 39; line white 17 -17 2 -5 14 19 -13;"
                 "line done 11 -17 2 -5 14 19 -13",
    "start": "ring trail+45 0 0 24 5; oval trail+45 0 0 9",
    "target": "ring white 0 0 52 12; ring target 0 0 52 7; line white 11 0 -64 0 -44; line white 11 0 44 0 64;"
              "line white 11 -64 0 -44 0; line white 11 44 0 64 0; line target 7 0 -64 0 -43; line target 7 0 43 0 64;"
              "line target 7 -64 0 -43 0; line target 7 43 0 64 0",
    "barred": "frame barred -47 -47 47 47 9 5; oval white 34 -34 17; oval barred 34 -34 14; box white 26 -37 42 -31 1",
    "drone": "line hull 8 -30 -30 30 30; line hull 8 30 -30 -30 30; oval hull -30 -30 21; oval hull 30 -30 21;"
             "oval hull -30 30 21; oval hull 30 30 21; box hull -16 -22 16 22 8; cast 24 5 34 1;"
             "oval rotor -30 -30 23; oval rotor 30 -30 23; oval rotor -30 30 23; oval rotor 30 30 23;"
             "line blade 5 -44 -36 -16 -24; line blade 5 22 -45 38 -15; line blade 5 -37 16 -23 44;"
             "line blade 5 17 24 43 36; ring rotor_rim -30 -30 23 3; ring rotor_rim 30 -30 23 3;"
             "ring rotor_rim -30 30 23 3; ring rotor_rim 30 30 23 3;"
             "line hull 9 -30 -30 30 30; line hull 9 30 -30 -30 30; oval hull_light -30 -30 6; oval hull_light 30 -30 6;"
             "oval target -30 30 6; oval target 30 30 6; box hull -17 -23 17 23 9; box hull_light -12 -9 12 17 6;"
             "oval glass 0 -13 6; oval hull 0 -13 3; box drop -6 -1 6 9 2",
}
# fmt: on
ROOFS = ("roof_hip", "roof_flat", "roof_garden", "roof_tower")
STANDING = {Cell.BUILDING: "building", Cell.TREE: "tree", Cell.OBSTACLE: "obstacle", Cell.PAD: "pad"}

MIN_SIZE, MAX_SIZE = 64, 4096
MAX_TRAIL = 1000
"""Steps of the trail that are drawn, so that a flight of 32 000 steps does not slow its pictures down."""
PANEL = 0.46
"""Width of the panel as a share of `size`."""
PANEL_TEXT = 38.0
"""Width of the text in the panel, in hundredths of `size`."""

Point = tuple[float, float]


class Layout(NamedTuple):
    """Where things are, in pixels."""

    size: int
    cell: int
    left: int
    top: int
    city: int
    """Width of the city part; the panel begins there."""
    width: int

    def centre(self, x: int, y: int) -> Point:
        """The middle of a cell."""
        return self.left + (x + 0.5) * self.cell, self.top + (y + 0.5) * self.cell

    def panel(self, x: float, y: float) -> Point:
        """A point of the panel, given in hundredths of `size` from where its text begins."""
        return self.city + (x + 2.5) * self.size / 100, y * self.size / 100

    @property
    def figure(self) -> int:
        """Side of what has to stay visible on large grids: drone, parcels and target."""
        return min(max(self.cell, self.size // 28), self.size // 6)


def draw_mission(episode: Episode, size: int = 720) -> npt.NDArray[np.uint8]:
    """The mission as a picture; equal episodes give equal pictures.

    Args:
        episode: A started episode; it is left as it is.
        size: Height of the picture in pixels, 64 to 4096. The width follows from it and from the shape of the grid.

    Returns:
        uint8[size, width, 3], RGB, with an even width. The trail holds the last 1000 steps.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the size is out of range.
    """
    return np.array(_picture(episode, size), dtype=np.uint8)


def save_picture(episode: Episode, path: str | PathLike[str], size: int = 720) -> None:
    """Write the picture of `draw_mission` to a file, and create its folders where they are missing.

    Args:
        episode: A started episode; it is left as it is.
        path: Where to; the suffix names the format, such as `.png`.
        size: Height of the picture in pixels, 64 to 4096.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the size is out of range.
        ValueError: if the suffix names no image format.
        OSError: if the file cannot be written.
    """
    picture = _picture(episode, size)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)


def _picture(episode: Episode, size: int) -> Image.Image:
    seed = episode.seed
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise InvalidValueError(f"size must be {MIN_SIZE} to {MAX_SIZE} pixels, got {size!r}")
    layout = _layout(episode.task, size)
    picture = _city(episode.task, seed, size).copy()
    _draw_lines(picture, layout, episode)
    for x, y, delivered in episode.parcels:
        _stamp(picture, ART["delivered" if delivered else "parcel"], layout.figure, layout.centre(x, y))
    if episode.target is not None:
        _stamp(picture, ART["target"], layout.figure, layout.centre(*episode.target))
    _stamp(picture, ART["drone"], min(max(layout.cell * 8 // 7, size // 22), size // 5), layout.centre(*episode.position))
    _draw_status(picture, layout, episode)
    return picture


def _layout(task: TaskConfig, size: int) -> Layout:
    margin = round(size * 0.045)
    cell = max(1, min((size - 2 * margin) // task.height, (2 * size - 2 * margin) // task.width))
    city = task.width * cell + 2 * margin
    width = city + round(size * PANEL)
    return Layout(size, cell, margin, (size - task.height * cell) // 2, city, width + width % 2)


@lru_cache(maxsize=4)
def _city(task: TaskConfig, seed: int, size: int) -> Image.Image:
    """All of a mission's picture that stays as it is. Shared: draw on a copy."""
    city = generate_city_map(task, seed)
    layout = _layout(task, size)
    picture = Image.new("RGB", (layout.width, size), PALETTE["backdrop"])
    _lay_ground(picture, layout, city.grid)
    _stamp(picture, ART["start"], layout.figure, layout.centre(*city.start))
    for (y, x), kind in np.ndenumerate(city.grid):
        name, variety = STANDING.get(kind), _scramble(x, y)
        at = layout.centre(x, y)
        if name == "building":
            _stamp(picture, ART[name] + ART[ROOFS[variety % 4]], layout.cell, at, f"roof{variety // 4 % 6}")
        elif name is not None:
            _stamp(picture, ART[f"tree{variety % 4}" if name == "tree" else name], layout.cell, at)
        if kind in task.impassable:
            _stamp(picture, ART["barred"], layout.cell, at)
    _lay_panel(picture, layout, task, seed)
    return picture


def _scramble(x: int, y: int) -> int:
    """A fixed number that looks random, for variety between cells."""
    number = (x * 0x9E3779B1 + y * 0x85EBCA77 + 0x27D4EB2F) & 0xFFFFFFFF
    number = ((number ^ number >> 15) * 0x2C1B3C6D) & 0xFFFFFFFF
    return (number ^ number >> 12) >> 4


def _around(at: Point, reach: float, reach_y: float | None = None) -> tuple[float, float, float, float]:
    reach_y = reach if reach_y is None else reach_y
    return at[0] - reach, at[1] - reach_y, at[0] + reach, at[1] + reach_y


def _lay_ground(picture: Image.Image, layout: Layout, grid: npt.NDArray[np.uint8]) -> None:
    """Lawns, streets that join all cells on which neither a building nor a tree stands, and numbers at the edges."""
    rows, columns = grid.shape
    rim, fine = layout.size // 90, 3 if layout.size <= 1000 else 2
    unit, base = layout.cell * fine, rim * fine
    wide, high = columns * unit + 2 * base, rows * unit + 2 * base
    ground = Image.new("RGB", (wide, high), PALETTE["lawn0"])
    streets, marks = Image.new("L", (wide, high)), Image.new("L", (wide, high))
    pen, street_pen, mark_pen = ImageDraw.Draw(ground), ImageDraw.Draw(streets), ImageDraw.Draw(marks)
    for x, y in np.ndindex(columns + 1, rows + 1):
        variety, corner = _scramble(x + 200, y), (base + x * unit, base + y * unit)
        pen.rectangle(_around(corner, unit / 2), fill=PALETTE[f"lawn{variety % 3}"])
        for i in range(variety // 8 % 4 * (0 < x < columns and 0 < y < rows)):
            angle = variety % 628 / 100 + 2.4 * i
            at = corner[0] + 0.13 * unit * math.cos(angle), corner[1] + 0.13 * unit * math.sin(angle)
            pen.ellipse(_around(at, unit * (0.04 + 0.015 * i)), fill=PALETTE["shrub"])
    paved = ~np.isin(grid, (Cell.BUILDING, Cell.TREE))
    half = 0.225 * unit
    for y, x in np.argwhere(paved).tolist():
        middle = base + (x + 0.5) * unit, base + (y + 0.5) * unit
        street_pen.ellipse(_around(middle, half), fill=255)
        if x + 1 < columns and paved[y, x + 1]:
            edge = middle[0] + unit / 2, middle[1]
            street_pen.rectangle(_around(edge, unit / 2, half), fill=255)
            mark_pen.rectangle(_around(edge, 0.11 * unit, 0.016 * unit), fill=255)
        if y + 1 < rows and paved[y + 1, x]:
            edge = middle[0], middle[1] + unit / 2
            street_pen.rectangle(_around(edge, half, unit / 2), fill=255)
            mark_pen.rectangle(_around(edge, 0.016 * unit, 0.11 * unit), fill=255)
    # Cutting the blurred streets at one level rounds their corners, at a lower one it widens them by the kerb.
    soft = streets.filter(ImageFilter.GaussianBlur(unit * 0.07))
    ground.paste(PALETTE["kerb"], mask=soft.point([255 * (level > 70) for level in range(256)]))
    ground.paste(PALETTE["street"], mask=soft.point([255 * (level > 120) for level in range(256)]))
    ground.paste(PALETTE["marking"], mask=marks)
    _slab(picture, (layout.left - rim, layout.top - rim), ground.reduce(fine), 2.2 * rim)

    pen, height = ImageDraw.Draw(picture), layout.size / 60
    every = next(step for step in (1, 2, 4, 8, 16, 32) if step == 32 or layout.cell * step >= 2.1 * height)
    for x in range(0, columns, every):
        _write(pen, (layout.centre(x, 0)[0], layout.top - rim - height / 2), str(x), height, "muted", "ms")
    for y in range(0, rows, every):
        _write(pen, (layout.left - rim - height / 2, layout.centre(0, y)[1]), str(y), height, "muted", "rm")


def _slab(picture: Image.Image, at: tuple[int, int], face: Image.Image, radius: float) -> None:
    """Lay a picture with rounded corners and a soft shadow on another."""
    reach = max(1, picture.height // 90)
    mask = Image.new("L", (face.width * 3, face.height * 3))
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, mask.width - 1, mask.height - 1), radius=3 * radius, fill=255)
    mask = mask.reduce(3)
    cast = Image.new("L", picture.size)
    cast.paste(mask, (at[0], at[1] + reach // 2))
    cast = cast.filter(ImageFilter.GaussianBlur(reach)).point([level * 2 // 5 for level in range(256)])
    picture.paste(PALETTE["shadow"], mask=cast)
    picture.paste(face, at, mask)


# Figures.


def _stamp(picture: Image.Image, art: str, cell: int, at: Point, roof: str = "") -> None:
    figure = _figure(art, cell, roof)
    picture.paste(figure, (round(at[0] - figure.width / 2), round(at[1] - figure.height / 2)), figure)


def _colour(name: str) -> str:
    """A colour of the palette; `name+20` is mixed with 20 % white, `name-20` with 20 % black."""
    for sign, goal in (("+", 255), ("-", 0)):
        base, found, percent = name.partition(sign)
        if found:
            parts = (int(PALETTE[base][i : i + 2], 16) for i in (1, 3, 5))
            return "#" + "".join(f"{round(part + (goal - part) * int(percent) / 100):02X}" for part in parts)
    return PALETTE[name]


@lru_cache(maxsize=256)
def _figure(art: str, cell: int, roof: str) -> Image.Image:
    """Draw an entry of `ART`, larger than needed and then reduced, for smooth edges. Shared: do not draw on it."""
    fine = 4 if cell <= 100 else 2
    unit = cell * fine / 100
    side = (cell + 2 * math.ceil(0.4 * cell)) * fine
    below, layer = Image.new("RGBA", (side, side)), Image.new("RGBA", (side, side))
    for item in filter(None, map(str.strip, art.split(";"))):
        shape, *words = item.split()
        if shape in ("lift", "cast", "flat"):
            if shape != "flat":
                below.alpha_composite(_shadow(layer, unit, *map(int, words)))
            if shape != "cast":
                below.alpha_composite(layer)
            layer = Image.new("RGBA", (side, side))
            continue
        colour = _colour(words[0].replace("roof", roof) if words[0].startswith("roof") and roof else words[0])
        # Pillow replaces what lies under translucent colours, so these get a layer of their own.
        glaze = Image.new("RGBA", (side, side)) if len(colour) > 7 else layer
        _trace(ImageDraw.Draw(glaze), shape, colour, words[0], [int(word) * unit for word in words[1:]], side / 2)
        if glaze is not layer:
            layer.alpha_composite(glaze)
    below.alpha_composite(layer)
    return below.reduce(fine)


def _shadow(layer: Image.Image, unit: float, reach: int, blur: int, strength: int, steps: int) -> Image.Image:
    alpha = layer.getchannel("A")
    cast = Image.new("L", alpha.size)
    for step in range(1, steps + 1):
        offset = reach * unit * step / steps
        cast = ImageChops.lighter(cast, ImageChops.offset(alpha, round(0.7 * offset), round(offset)))
    shadow = Image.new("RGBA", alpha.size, PALETTE["shadow"])
    shadow.putalpha(cast.filter(ImageFilter.GaussianBlur(blur * unit)).point([i * strength // 100 for i in range(256)]))
    return shadow


def _trace(pen: ImageDraw.ImageDraw, shape: str, colour: str, name: str, numbers: list[float], mid: float) -> None:
    if shape == "crown":
        x, y, r = numbers
        for dx, dy, share, tone in ((0, 0, 1, "-18"), (-0.09, -0.12, 0.86, ""), (-0.30, -0.34, 0.36, "+24")):
            pen.ellipse(_around((mid + x + dx * r, mid + y + dy * r), share * r), fill=_colour(name + tone))
        for angle in (0.4, 1.5, 2.7, 5.3):
            at = mid + x + 0.56 * r * math.cos(angle), mid + y + 0.56 * r * math.sin(angle)
            pen.ellipse(_around(at, 0.11 * r), fill=_colour(name + "-18"))
    elif shape == "oval":
        pen.ellipse(_around((mid + numbers[0], mid + numbers[1]), numbers[2]), fill=colour)
    elif shape == "ring":
        box = _around((mid + numbers[0], mid + numbers[1]), numbers[2] + numbers[3] / 2)
        pen.ellipse(box, outline=colour, width=max(1, round(numbers[3])))
    elif shape == "box":
        pen.rounded_rectangle([mid + number for number in numbers[:4]], radius=numbers[4], fill=colour)
    elif shape == "frame":
        box = [mid + number for number in numbers[:4]]
        pen.rounded_rectangle(box, radius=numbers[4], outline=colour, width=max(1, round(numbers[5])))
    elif shape == "poly":
        pen.polygon([mid + number for number in numbers], fill=colour)
    else:
        _stroke(pen, [(mid + x, mid + y) for x, y in zip(numbers[1::2], numbers[2::2], strict=True)], numbers[0], colour)


def _stroke(pen: ImageDraw.ImageDraw, points: list[Point], width: float, colour: str | int) -> None:
    """A line with round ends and joints."""
    wide = max(1, round(width))
    pen.line(points, fill=colour, width=wide)
    for at in points:
        pen.ellipse(_around(at, (wide - 1) / 2), fill=colour)


# What changes with each step.


def _draw_lines(picture: Image.Image, layout: Layout, episode: Episode) -> None:
    """The trail, fading with age, and a dashed line from the drone to its target."""
    fine = 3 if layout.size <= 1000 else 2
    casing, trail, dashes = (Image.new("L", (layout.city * fine, layout.size * fine)) for _ in range(3))
    width = max(2.0, min(0.14 * layout.cell, layout.size / 80)) * fine
    if episode.target is not None:
        here, there = layout.centre(*episode.position), layout.centre(*episode.target)
        length = math.dist(here, there) * fine
        for i in range(1, int(length / (3.2 * width))):
            shares = (3.2 * width * i / length, 3.2 * width * (i + 0.45) / length)
            dash = [tuple(fine * (a + (b - a) * t) for a, b in zip(here, there, strict=True)) for t in shares]
            _stroke(ImageDraw.Draw(casing), dash, 1.3 * width, 190)
            _stroke(ImageDraw.Draw(dashes), dash, 0.7 * width, 235)
    ways = [(fine * x, fine * y) for x, y in _smooth(_stops(layout, episode))]
    for mask, wide, strong in ((casing, 1.9 * width, 210), (trail, width, 255)):
        pen = ImageDraw.Draw(mask)
        for i in range(len(ways) - 1):
            _stroke(pen, ways[i : i + 2], wide, round(strong * (0.30 + 0.70 * (i + 1) / len(ways))))
    for mask, name in ((casing, "white"), (dashes, "target"), (trail, "trail")):
        picture.paste(PALETTE[name], (0, 0, layout.city, layout.size), mask.reduce(fine))


def _stops(layout: Layout, episode: Episode) -> list[Point]:
    """The middles of the cells flown over, from the start on; a turning point stands there twice."""
    cells = [(step.x, step.y) for step in episode.path]
    cells = [generate_city_map(episode.task, episode.seed).start, *cells][-MAX_TRAIL - 1 :]
    stops: list[Point] = []
    for at in (layout.centre(*cell) for cell in cells):
        if stops[-1:] != [at]:
            stops += [stops[-1], at] if stops[-2:-1] == [at] else [at]
    return stops


def _smooth(points: list[Point]) -> list[Point]:
    """Corners cut off three times (Chaikin's way); doubled points stay where they are."""
    for _ in range(3):
        pairs = zip(points, points[1:], strict=False)
        cut = [(a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t) for a, b in pairs for t in (0.25, 0.75)]
        points = points[:1] + cut + points[-1:]
    return points


# The panel.


@lru_cache(maxsize=64)
def _font(height: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=height)


def _write(pen: ImageDraw.ImageDraw, at: Point, words: str, height: float, colour: str, anchor: str = "ls",
           width: float = math.inf, bold: bool = False) -> None:
    """Words on one line, made smaller and at last cut short where they are wider than `width` pixels."""
    height = full = max(1, round(height))
    while height > 0.7 * full and _font(height).getlength(words) > width:
        height -= 1
    if _font(height).getlength(words) > width:
        while words and _font(height).getlength(words + "...") > width:
            words = words[:-1]
        words += "..."
    for x in (0, 0.022 * height)[: 1 + bold]:
        pen.text((at[0] + x, at[1]), words, fill=PALETTE[colour], font=_font(height), anchor=anchor)


def _wrap(words: str, height: float, width: float) -> list[str]:
    lines = [""]
    for word in words.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and _font(max(1, round(height))).getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _bar(picture: Image.Image, start: Point, end: Point, radius: float, colour: str) -> None:
    """A filled rectangle with rounded, smooth corners."""
    x, y = round(start[0]), round(start[1])
    mask = Image.new("L", (max(1, round(end[0]) - x) * 4, max(1, round(end[1]) - y) * 4))
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, mask.width - 1, mask.height - 1), radius=4 * radius, fill=255)
    picture.paste(PALETTE[colour], (x, y), mask.reduce(4))


def _lay_panel(picture: Image.Image, layout: Layout, task: TaskConfig, seed: int) -> None:
    """What the panel always shows: whose map it is, the names of its gauges, and a legend."""
    u, rim = layout.size / 100, layout.size // 90
    top = min(layout.top, layout.left * 3 // 2) - rim
    left = layout.panel(-2.5, 0)[0] - rim
    face = Image.new("RGB", (round(layout.width - layout.left + rim - left), layout.size - 2 * top), PALETTE["card"])
    _slab(picture, (round(left), top), face, 2.2 * rim)
    pen = ImageDraw.Draw(picture)
    title = task.id.replace("_", " ").capitalize()
    _write(pen, layout.panel(0, 11), title, 4.8 * u, "ink", width=PANEL_TEXT * u, bold=True)
    _write(pen, layout.panel(0, 15.2), f"map {seed}", 2.4 * u, "muted", width=PANEL_TEXT * u)
    for y, name in ((37.5, "Battery"), (47.5, "Steps"), (56.5, "Delivered")):
        _write(pen, layout.panel(0, y), name, 2.5 * u, "muted")
    _write(pen, layout.panel(0, 22.8), "Score x 100", 2.5 * u, "muted")
    entries = [(ART["building"] + ART["roof_flat"], "building"), (ART["tree1"], "tree"), (ART["obstacle"], "obstacle"),
               (ART["parcel"], "parcel"), (ART["delivered"], "delivered"), (ART["target"], "target")]
    entries += [(ART["pad"], "pad")] * (task.pads > 0)
    entries += [(ART["barred"], "no entry")] * bool(task.impassable)
    for i, (art, name) in enumerate(entries):
        x, y = i % 3 * 13.1, 92.3 - 4.5 * ((len(entries) - 1) // 3 - i // 3)
        side = 2.2 if name == "target" else 3.2
        _stamp(picture, art, max(1, round(side * u)), layout.panel(x + 1.6, y), "roof1")
        _write(pen, layout.panel(x + 3.9, y), name, 1.95 * u, "muted", "lm", width=8.6 * u)


def _draw_status(picture: Image.Image, layout: Layout, episode: Episode) -> None:
    """What the panel shows of the moment."""
    u, pen, task = layout.size / 100, ImageDraw.Draw(picture), episode.task
    right = PANEL_TEXT
    words, colour = STATUS[episode.outcome]
    _bar(picture, layout.panel(20.5, 24.6), layout.panel(right, 29.6), 2.5 * u, colour)
    _write(pen, layout.panel((20.5 + right) / 2, 27.1), words, 2.4 * u, "card", "mm", width=16 * u)
    _write(pen, layout.panel(0, 30), f"{100 * episode.score:.1f}", 6.4 * u, "ink", bold=True)

    level = "good" if episode.battery > 0.5 else "fair" if episode.battery > 0.2 else "low"
    rows = ((37.5, 2.6, episode.battery_units, task.battery_capacity, level),
            (47.5, 1.4, episode.steps, task.max_steps, "flight"))
    for y, high, value, most, colour in rows:
        _write(pen, layout.panel(right, y), f"{value} / {most}", 2.5 * u, "ink", "rs")
        _bar(picture, layout.panel(0, y + 1.8), layout.panel(right, y + 1.8 + high), high / 2 * u, "rail")
        if value:
            long = max(high, right * value / most)
            _bar(picture, layout.panel(0, y + 1.8), layout.panel(long, y + 1.8 + high), high / 2 * u, colour)

    _write(pen, layout.panel(right, 56.5), f"{episode.deliveries_done} / {task.deliveries}", 2.5 * u, "ink", "rs")
    for i in range(task.deliveries):
        art = ART["delivered" if i < episode.deliveries_done else "parcel"]
        _stamp(picture, art, max(1, round(4.2 * u)), layout.panel(2.2 + i % 8 * 4.8, 60.6 + i // 8 * 4.9))

    _bar(picture, layout.panel(-1, 69.5), layout.panel(right + 1, 81.5), 1.4 * u, "tint")
    lines = _wrap(episode.message, 2.5 * u, (right - 2) * u)
    for i, line in enumerate(lines):
        at = layout.panel(1, 75.5 + 3.3 * (i - (len(lines) - 1) / 2))
        _write(pen, at, line, 2.5 * u, "ink", "lm", width=(right - 2) * u)


STATUS = {
    Outcome.FLYING: ("In flight", "flight"),
    Outcome.DELIVERED: ("All delivered", "good"),
    Outcome.BATTERY_DEAD: ("Battery empty", "low"),
    Outcome.OUT_OF_STEPS: ("Out of steps", "fair"),
}
