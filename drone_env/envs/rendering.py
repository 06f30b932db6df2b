"""An episode as a picture: the city from above, and a panel with the status of the flight.

`tools/draw_figures.py` makes the sprites of the figures from `art/figures.svg`, which the page also uses.
"""

import math
import textwrap
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from drone_env.core.actions import Outcome
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.grid_generator import generate_city_map
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError

ART = Path(__file__).parent / "art"
Point = tuple[float, float]
_COLOURS = """
backdrop #DCE6E6, card #FDFCF8, rail #E7EBE5, tint #F1F4EE, ink #24343B, muted #78878B, white #FFFFFF,
good #55A27A, fair #E3A94B, low #DB6058, flight #6C83C6, trail #4C63B6, target #E0525F, lawn #CFDEBB, kerb #DDD8C6,
street #F7F4EA
"""
PALETTE = {pair.split()[0]: pair.split()[1] for pair in _COLOURS.split(",")}
STATUS = {
    Outcome.FLYING: ("In flight", "flight"),
    Outcome.DELIVERED: ("All delivered", "good"),
    Outcome.BATTERY_DEAD: ("Battery empty", "low"),
    Outcome.OUT_OF_STEPS: ("Out of steps", "fair"),
}
MIN_SIZE, MAX_SIZE, MAX_TRAIL = 64, 4096, 400  # pixels, pixels, steps: they limit the cost of a picture
_font = lru_cache(maxsize=64)(ImageFont.load_default)
FPS = 8  # pictures per second of a window, and of a film
MAX_FILM, REST = 30 * FPS, 2000  # pictures of a film, and milliseconds of its last one
PANEL, TEXT = 46, 38  # widths of the panel and of its text, in hundredths of the picture's height


class Layout(NamedTuple):
    """Positions in pixels: picture height, side of a cell, left and top of the grid, rim, width of the city part."""

    size: int
    cell: int
    left: int
    top: int
    rim: int
    city: int

    def centre(self, x: float, y: float) -> Point:
        """The middle of a cell."""
        return self.left + (x + 0.5) * self.cell, self.top + (y + 0.5) * self.cell

    def panel(self, x: float, y: float) -> Point:
        """A point of the panel, in hundredths of `size` from the left of its text and the top of the picture."""
        return self.city + (x + 2.5) * self.size / 100, y * self.size / 100

    def draw_figure(self, share: float = 1.0) -> int:
        """Side of a figure that must stay visible on large grids and fit on small ones."""
        return round(min(max(share * self.cell, self.size / 28), self.size / 6))


def draw_picture(episode: Episode, size: int = 720) -> npt.NDArray[np.uint8]:
    """The episode as a picture. Equal episodes give equal pictures. The trail shows the last 400 steps.

    Args:
        episode: A started episode; it is not changed.
        size: Height of the picture in pixels, 64 to 4096. The width depends on it and on the shape of the grid.

    Returns:
        uint8[size, width, 3], RGB, with an even width.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the size is out of range.
    """
    return np.array(_picture(episode, size), dtype=np.uint8)


def save_picture(episode: Episode, path: str | Path, size: int = 720) -> None:
    """Write the picture of `draw_picture` to a file in the format of its suffix. Missing folders are created.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the size is not 64 to 4096 pixels.
        ValueError: if the suffix is not an image format.
        OSError: if the file cannot be written.
    """
    picture = _picture(episode, size)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    picture.save(path)


def save_film(episode: Episode, path: str | Path, size: int = 480) -> None:
    """Write the flight as an animated GIF of at most half a minute: 8 pictures per second, and the last one longer.

    A picture is a step; of long flights, every second, third or further one.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the size is not 64 to 4096 pixels.
        OSError: if the file cannot be written.
    """
    last = _picture(episode, size)
    # All pictures share the colours of the last one and of the palette.
    colours = Image.new("RGB", (last.width, last.height + len(PALETTE)))
    colours.paste(last)
    for row, colour in enumerate(PALETTE.values()):
        colours.paste(colour, (0, last.height + row, last.width, last.height + row + 1))
    palette = colours.quantize(256, Image.Quantize.MAXCOVERAGE)
    every = max(1, math.ceil(episode.steps / MAX_FILM))
    flown = Episode(episode.task, episode.reward_profile, episode.seed)
    first = _picture(flown, size).quantize(palette=palette, dither=Image.Dither.NONE)

    def pictures() -> Iterator[Image.Image]:
        for step, action in enumerate(episode.actions, 1):
            flown.step(action)
            if step % every == 0 or step == episode.steps:
                yield _picture(flown, size).quantize(palette=palette, dither=Image.Dither.NONE)

    milliseconds = [1000 // FPS] * math.ceil(episode.steps / every) + [REST]
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    first.save(path, "GIF", save_all=True, append_images=pictures(), duration=milliseconds, loop=0)


def _picture(episode: Episode, size: int) -> Image.Image:
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise InvalidValueError(f"size must be {MIN_SIZE} to {MAX_SIZE} pixels, got {size!r}")
    layout = _layout(episode.task, size)
    picture = _city(episode.task, episode.task.attribution, episode.seed, size).copy()
    _draw_lines(picture, layout, episode)
    for x, y, delivered in episode.parcels:
        _stamp(picture, "delivered" if delivered else "parcel", layout.draw_figure(), layout.centre(x, y))
    if episode.target is not None:
        _stamp(picture, "target", layout.draw_figure(), layout.centre(*episode.target))
    _stamp(picture, "drone", layout.draw_figure(1.15), layout.centre(*episode.position))
    _draw_status(picture, layout, episode)
    return picture


def _layout(task: TaskConfig, size: int) -> Layout:
    columns, rows, margin = task.width, task.height, round(size * 0.045)
    cell = max(1, min((size - 2 * margin) // rows, (2 * size - 2 * margin) // columns))
    return Layout(size, cell, margin, (size - rows * cell) // 2, size // 90, columns * cell + 2 * margin)


@lru_cache(maxsize=16)
def _city(task: TaskConfig, attribution: str, seed: int, size: int) -> Image.Image:
    """The static part of a picture. Cached: draw on a copy. Equal tasks may have different attributions."""
    city, layout = generate_city_map(task, seed), _layout(task, size)
    width = layout.city + round(size * PANEL / 100)
    picture = Image.new("RGB", (width + width % 2, size), PALETTE["backdrop"])
    _lay_map(picture, layout, city.grid, task.impassable)
    _stamp(picture, "start", layout.draw_figure(), layout.centre(*city.start))
    _lay_panel(picture, layout, task, seed)
    _lay_attribution(picture, layout, task.height, attribution)
    return picture


def _lay_attribution(picture: Image.Image, layout: Layout, rows: int, words: str) -> None:
    """Write the attribution of a city's data below the map."""
    if words:
        left, bottom = layout.left, layout.top + rows * layout.cell + 1.4 * layout.rim
        height = min(layout.size / 44, layout.size - bottom)
        _write(ImageDraw.Draw(picture), (left, bottom), words, height, "muted", "la", layout.city - 2 * left)


def _lay_map(picture: Image.Image, layout: Layout, grid: npt.NDArray[np.uint8], closed: Collection[Cell]) -> None:
    """Draw the ground, its figures, and the numbers of columns and rows."""
    fine = 3 if layout.size <= 1000 else 2
    ground = _draw_streets(grid, layout.cell * fine, layout.rim * fine).reduce(fine)
    at, radius = (layout.left - layout.rim, layout.top - layout.rim), 2.2 * layout.rim
    _lay(picture, (*at, at[0] + ground.width, at[1] + ground.height), ground, radius)
    rows, columns = grid.shape
    pen, height = ImageDraw.Draw(picture), layout.size / 60
    every = next(step for step in (1, 2, 4, 8, 16, 32) if step == 32 or layout.cell * step >= 2.1 * height)
    for x in range(0, columns, every):
        _write(pen, (layout.centre(x, 0)[0], at[1] - height / 2), str(x), height, "muted", "ms")
    for y in range(0, rows, every):
        _write(pen, (at[0] - height / 2, layout.centre(0, y)[1]), str(y), height, "muted", "rm")
    for (y, x), kind in np.ndenumerate(grid):
        if kind in (Cell.ROAD, Cell.DELIVERY):
            continue
        some, middle = variety(x, y), layout.centre(x, y)
        size = max(layout.cell, layout.size // 45) if kind == Cell.PAD else layout.cell
        number = {Cell.BUILDING: some % 8, Cell.TREE: some % 4}.get(Cell(kind), "")
        _stamp(picture, f"{CELL_KINDS[Cell(kind)].name}{number}", size, middle)
        if kind in closed:
            _stamp(picture, "no_entry", size, middle)


def _draw_streets(grid: npt.NDArray[np.uint8], unit: int, base: int) -> Image.Image:
    """Draw lawns, and streets through all cells without building or tree."""
    rows, columns = grid.shape
    wide, high = columns * unit + 2 * base, rows * unit + 2 * base
    ground, streets = Image.new("RGB", (wide, high), PALETTE["lawn"]), Image.new("L", (wide, high))
    pen = ImageDraw.Draw(streets)
    paved = np.pad(~np.isin(grid, (Cell.BUILDING, Cell.TREE)), (0, 1))
    for y, x in np.argwhere(paved).tolist():
        for dx, dy in ((0, 0), (1, 0), (0, 1)):
            if paved[y + dy, x + dx]:
                at = base + (x + 0.5 + dx / 2) * unit, base + (y + 0.5 + dy / 2) * unit
                pen.rectangle(around(at, (0.225 + dx / 2) * unit, (0.225 + dy / 2) * unit), fill=255)
    # A threshold of the blurred streets rounds their corners; a lower one adds the kerb.
    soft = streets.filter(ImageFilter.GaussianBlur(unit * 0.09))
    ground.paste(PALETTE["kerb"], mask=soft.point([255 * (level > 70) for level in range(256)]))
    ground.paste(PALETTE["street"], mask=soft.point([255 * (level > 120) for level in range(256)]))
    return ground


def _lay_panel(picture: Image.Image, layout: Layout, task: TaskConfig, seed: int) -> None:
    """Draw the static part of the panel: task, map, names of the gauges, legend."""
    u, rim, pen = layout.size / 100, layout.rim, ImageDraw.Draw(picture)
    top = min(layout.top, layout.left + rim) - rim
    box = layout.city - rim, top, layout.city + PANEL * u - layout.left + rim, layout.size - top
    _lay(picture, box, "card", 2.2 * rim)
    _write(pen, layout.panel(0, 11), task.id.replace("_", " ").capitalize(), 4.8 * u, "ink", width=TEXT * u, bold=True)
    _write(pen, layout.panel(0, 15.2), f"map {seed}", 2.4 * u, "muted", width=TEXT * u)
    for y, name in ((22.8, "Score x 100"), (37.5, "Battery"), (47.5, "Steps"), (56.5, "Delivered")):
        _write(pen, layout.panel(0, y), name, 2.5 * u, "muted")
    figures = ["building5", "tree1", "obstacle", "parcel", "delivered", "target"]
    figures += ["pad"] * (task.pads > 0) + ["no_entry"] * bool(task.impassable)
    for i, figure in enumerate(figures):
        x, y = i % 3 * 13.1, 92.3 - 4.5 * ((len(figures) - 1) // 3 - i // 3)
        side, middle = round((2.2 if figure == "target" else 3.2) * u), layout.panel(x + 1.6, y)
        _stamp(picture, figure, side, middle)
        _write(pen, layout.panel(x + 3.9, y), figure.rstrip("15").replace("_", " "), 1.95 * u, "muted", "lm", 8.6 * u)


def _draw_lines(picture: Image.Image, layout: Layout, episode: Episode) -> None:
    """Draw the trail, and a dashed line from the drone to its target."""
    fine = 3 if layout.size <= 1000 else 2
    width = max(2.0, min(0.14 * layout.cell, layout.size / 80)) * fine
    trail, dashes = (Image.new("L", (layout.city * fine, layout.size * fine)) for _ in range(2))
    start = generate_city_map(episode.task, episode.seed).start
    cells = [start, *((step.x, step.y) for step in episode.path)][-MAX_TRAIL - 1 :]
    stroke(ImageDraw.Draw(trail), [(fine * x, fine * y) for x, y in (layout.centre(*cell) for cell in cells)], width)
    if episode.target is not None:
        (x, y), to = layout.centre(*episode.position), layout.centre(*episode.target)
        spacing = 3.2 * width / (fine * math.dist((x, y), to))
        for i in range(1, int(1 / spacing)):
            ends = (spacing * i, spacing * (i + 0.45))
            dash = [(fine * (x + (to[0] - x) * t), fine * (y + (to[1] - y) * t)) for t in ends]
            stroke(ImageDraw.Draw(dashes), dash, 0.7 * width)
    for mask, name in ((dashes, "target"), (trail, "trail")):
        picture.paste(PALETTE[name], (0, 0, layout.city, layout.size), mask.reduce(fine))


def _draw_status(picture: Image.Image, layout: Layout, episode: Episode) -> None:
    """Draw the changing part of the panel."""
    u, pen, task = layout.size / 100, ImageDraw.Draw(picture), episode.task
    words, colour = STATUS[episode.outcome]
    _lay(picture, (*layout.panel(20.5, 24.6), *layout.panel(TEXT, 29.6)), colour, 2.5 * u)
    _write(pen, layout.panel((20.5 + TEXT) / 2, 27.1), words, 2.4 * u, "card", "mm", width=14.5 * u)
    _write(pen, layout.panel(0, 30), f"{100 * episode.score:.1f}", 6.4 * u, "ink", bold=True)
    level = "good" if episode.battery > 0.5 else "fair" if episode.battery > 0.2 else "low"
    gauges = (
        (37.5, 2.6, episode.battery_units, task.battery_capacity, level),
        (47.5, 1.4, episode.steps, task.max_steps, "flight"),
        (56.5, 0.0, episode.deliveries_done, task.deliveries, ""),
    )
    for y, high, value, most, colour in gauges:
        _write(pen, layout.panel(TEXT, y), f"{value} / {most}", 2.5 * u, "ink", "rs")
        for long, tone in ((TEXT, "rail"), (max(high, TEXT * value / most) * (value > 0), colour)):
            if high and long:
                _lay(picture, (*layout.panel(0, y + 1.8), *layout.panel(long, y + 1.8 + high)), tone, high / 2 * u)
    for i in range(task.deliveries):
        name = "delivered" if i < episode.deliveries_done else "parcel"
        _stamp(picture, name, round(4.2 * u), layout.panel(2.2 + i % 8 * 4.8, 60.6 + i // 8 * 4.9))
    _lay(picture, (*layout.panel(-1, 69.5), *layout.panel(TEXT + 1, 81.5)), "tint", 1.4 * u)
    lines = textwrap.wrap(episode.message, 32)
    for i, line in enumerate(lines):
        y = 75.5 + 3.3 * (i - (len(lines) - 1) / 2)
        _write(pen, layout.panel(1, y), line, 2.5 * u, "ink", "lm", (TEXT - 2) * u)


def _lay(on: Image.Image, box: Sequence[float], face: Image.Image | str, radius: float) -> None:
    """Paste a picture or a colour with rounded corners."""
    left, top, right, bottom = map(round, box)
    mask = Image.new("L", (max(2, right - left) * 3, max(2, bottom - top) * 3))
    radius = min(3 * radius, min(mask.size) / 2 - 2)  # Pillow 10 fails on rounder ones
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, mask.width - 1, mask.height - 1), radius, 255)
    on.paste(PALETTE[face] if isinstance(face, str) else face, (left, top), mask.reduce(3))


def _write(
    pen: ImageDraw.ImageDraw,
    at: Point,
    words: str,
    height: float,
    colour: str,
    anchor: str = "ls",
    width: float = math.inf,
    bold: bool = False,
) -> None:
    """Write one line of text, in a smaller font if it is wider than `width` pixels."""
    size = max(1, round(height))
    while size > 1 and _font(size).getlength(words) > width:
        size -= 1
    for x in (0, 0.022 * size)[: 1 + bold]:
        pen.text((at[0] + x, at[1]), words, fill=PALETTE[colour], font=_font(size), anchor=anchor)


def _stamp(picture: Image.Image, name: str, cell: int, at: Point) -> None:
    figure = draw_figure(name, max(1, cell))
    picture.paste(figure, (round(at[0] - figure.width / 2), round(at[1] - figure.height / 2)), figure)


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
