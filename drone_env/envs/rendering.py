"""An episode as a picture: the city from above, and the status of the flight below it.

`tools/draw_figures.py` makes the sprites of the figures from `art/figures.svg`, which the page also uses.
"""

import math
from collections.abc import Collection
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.grid_generator import generate_city_map
from drone_env.core.tasks import TaskConfig

ART = Path(__file__).parent / "art"
Point = tuple[float, float]
PALETTE = {
    "backdrop": "#DCE6E6",
    "ink": "#24343B",
    "muted": "#78878B",
    "trail": "#4C63B6",
    "target": "#E0525F",
    "lawn": "#CFDEBB",
    "street": "#F7F4EA",
}
FPS = 8  # pictures per second of a window
FINE = 2  # lines and streets are drawn larger by this factor, and reduced
_font = lru_cache(maxsize=64)(ImageFont.load_default)


class Layout(NamedTuple):
    """Positions in pixels: height and width of the picture, side of a cell, left and top of the grid, rim around it."""

    height: int
    width: int
    cell: int
    left: int
    top: int
    rim: int

    def centre(self, x: float, y: float) -> Point:
        """The middle of a cell."""
        return self.left + (x + 0.5) * self.cell, self.top + (y + 0.5) * self.cell

    def figure(self, share: float = 1.0) -> int:
        """Side of a figure that must stay visible on large grids and fit on small ones."""
        return round(min(max(share * self.cell, self.height / 28), self.height / 6))


def draw_picture(episode: Episode, size: int = 720) -> npt.NDArray[np.uint8]:
    """The episode as a picture. Equal episodes give equal pictures.

    Args:
        episode: A started episode; it is not changed.
        size: Height of the picture in pixels, at least 64. The width depends on it and on the shape of the grid.

    Returns:
        uint8[size, width, 3], RGB, with an even width.

    Raises:
        EpisodeError: before the first reset.
    """
    task = episode.task
    layout, picture = _layout(task, size), _city(task, task.attribution, episode.seed, size).copy()
    _draw_lines(picture, layout, episode)
    for x, y, delivered in episode.parcels:
        _stamp(picture, "delivered" if delivered else "parcel", layout.figure(), layout.centre(x, y))
    if episode.target is not None:
        _stamp(picture, "target", layout.figure(), layout.centre(*episode.target))
    _stamp(picture, "drone", layout.figure(1.15), layout.centre(*episode.position))
    status = (
        f"{task.id.replace('_', ' ').capitalize()}, map {episode.seed}: {episode.message}",
        f"score {100 * episode.score:.1f} of 100,  battery {episode.battery_units} of {task.battery_capacity},  "
        f"steps {episode.steps} of {task.max_steps},  delivered {episode.deliveries_done} of {task.deliveries}",
    )
    for line, words in enumerate(status):
        _write_below(picture, layout, task, line, words, "ink")
    return np.array(picture, dtype=np.uint8)


def save_picture(episode: Episode, path: str | Path, size: int = 720) -> None:
    """Write the picture of `draw_picture` to a file in the format of its suffix. Missing folders are created.

    Raises:
        EpisodeError: before the first reset.
        ValueError: if the suffix is not an image format.
        OSError: if the file cannot be written.
    """
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(draw_picture(episode, size)).save(path)


def _layout(task: TaskConfig, size: int) -> Layout:
    left, below = round(size * 0.045), round(size * 0.13)
    cell = max(1, min((size - left - below) // task.height, (2 * size - 2 * left) // task.width))
    width = max(task.width * cell + 2 * left, size // 2)
    return Layout(size, width + width % 2, cell, (width - task.width * cell) // 2, left, size // 90)


@lru_cache(maxsize=16)
def _city(task: TaskConfig, attribution: str, seed: int, size: int) -> Image.Image:
    """The static part of a picture. Cached: draw on a copy. Equal tasks may have different attributions."""
    city, layout = generate_city_map(task, seed), _layout(task, size)
    picture = Image.new("RGB", (layout.width, size), PALETTE["backdrop"])
    _lay_map(picture, layout, city.grid, task.impassable)
    _stamp(picture, "start", layout.figure(), layout.centre(*city.start))
    _write_below(picture, layout, task, 2, attribution, "muted")
    return picture


def _lay_map(picture: Image.Image, layout: Layout, grid: npt.NDArray[np.uint8], closed: Collection[Cell]) -> None:
    """Draw the ground, its figures, and the numbers of columns and rows."""
    ground = _draw_streets(grid, layout.cell * FINE, layout.rim * FINE).reduce(FINE)
    left, top = layout.left - layout.rim, layout.top - layout.rim
    picture.paste(ground, (left, top))
    rows, columns = grid.shape
    pen, height = ImageDraw.Draw(picture), layout.height / 60
    every = next(step for step in (1, 2, 4, 8, 16, 32) if step == 32 or layout.cell * step >= 2.1 * height)
    for x in range(0, columns, every):
        _write(pen, (layout.centre(x, 0)[0], top - height / 2), str(x), height, "muted", "ms")
    for y in range(0, rows, every):
        _write(pen, (left - height / 2, layout.centre(0, y)[1]), str(y), height, "muted", "rm")
    for (y, x), kind in np.ndenumerate(grid):
        if kind in (Cell.ROAD, Cell.DELIVERY):
            continue
        some, middle = crc32(bytes((x % 256, y % 256))) >> 8, layout.centre(x, y)
        size = max(layout.cell, layout.height // 45) if kind == Cell.PAD else layout.cell
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
                near, far = base + 0.275 * unit, base + 0.725 * unit
                pen.rectangle(
                    (near + x * unit, near + y * unit, far + (x + dx) * unit, far + (y + dy) * unit), fill=255
                )
    # A threshold of the blurred streets rounds their corners.
    soft = streets.filter(ImageFilter.GaussianBlur(unit * 0.09))
    ground.paste(PALETTE["street"], mask=soft.point([255 * (level > 120) for level in range(256)]))
    return ground


def _draw_lines(picture: Image.Image, layout: Layout, episode: Episode) -> None:
    """Draw a thin line from the drone to its target, and the trail."""
    width = round(max(2.0, min(0.14 * layout.cell, layout.height / 80)) * FINE)
    start = generate_city_map(episode.task, episode.seed).start
    trail = [start, *((step.x, step.y) for step in episode.path)]
    ahead = [episode.position, episode.target or episode.position]
    for name, cells, wide in (("target", ahead, width // 2), ("trail", trail, width)):
        mask = Image.new("L", (picture.width * FINE, picture.height * FINE))
        points = [(FINE * x, FINE * y) for x, y in (layout.centre(*cell) for cell in cells)]
        ImageDraw.Draw(mask).line(points, fill=255, width=wide, joint="curve")
        picture.paste(PALETTE[name], mask=mask.reduce(FINE))


def _write_below(picture: Image.Image, layout: Layout, task: TaskConfig, line: int, words: str, colour: str) -> None:
    """Write one of three lines of text below the map."""
    height, edge = layout.height / 38, layout.top - layout.rim
    top = layout.top + task.height * layout.cell + 1.6 * layout.rim + 1.25 * line * height
    _write(ImageDraw.Draw(picture), (edge, top), words, height, colour, "la", layout.width - 2 * edge)


def _write(
    pen: ImageDraw.ImageDraw,
    at: Point,
    words: str,
    height: float,
    colour: str,
    anchor: str,
    width: float = math.inf,
) -> None:
    """Write one line of text, in a smaller font if it is wider than `width` pixels."""
    size = max(1, round(height))
    while size > 1 and _font(size).getlength(words) > width:
        size -= 1
    pen.text(at, words, fill=PALETTE[colour], font=_font(size), anchor=anchor)


def _stamp(picture: Image.Image, name: str, cell: int, at: Point) -> None:
    figure = draw_figure(name, max(1, cell))
    picture.paste(figure, (round(at[0] - figure.width / 2), round(at[1] - figure.height / 2)), figure)


@lru_cache(maxsize=256)
def draw_figure(name: str, cell: int) -> Image.Image:
    """A figure for cells of this size, with a margin of 0.4 cells for its shadow. Cached: do not draw on it."""
    side = cell + 2 * math.ceil(0.4 * cell)
    with Image.open(ART / f"{name}.png") as sprite:
        return sprite.convert("RGBA").resize((side, side), Image.Resampling.BOX)
