"""The piece of the world that becomes a city: degrees to cells; areas, lines and coasts painted on a raster.

Coordinates of the raster: (x, y) of a corner are whole numbers, and the sample of column x and row y lies at
(x + 0.5, y + 0.5). Points far outside cost nothing.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.city.city_file import MIN_SIDE, BBox, check_bbox
from drone_env.errors import InvalidValueError

EQUATOR = 6_378_137.0
"""The semi-major axis of the ellipsoid of WGS 84, in metres."""
FLATTENING = 1 / 298.257223563
Points = npt.NDArray[np.float64]
"""float64[n, 2], (x, y)."""
Mask = npt.NDArray[np.bool_]
SIDES = 1024
"""Sides of an area that are painted together: bounds the memory."""
REACH = 1.5
"""Cells on both sides of a coast that are told by their distance; the others follow from their neighbours."""


class GridProjection(NamedTuple):
    """A grid of cells over the world, north up."""

    bbox: BBox
    columns: int
    rows: int
    cell: float
    """Metres along the side of a cell."""

    def to_cells(self, degrees: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """(longitude, latitude) in degrees as (x, y) in cells, from the north-western corner: float64[n, 2]."""
        west, south, east, north = self.bbox
        scale = self.columns / (east - west), -self.rows / (north - south)
        return (degrees - (west, north)) * scale


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """The length in metres of a degree of longitude and of one of latitude.

    From the radii of curvature of the ellipsoid: Snyder, "Map Projections: A Working Manual", U.S. Geological Survey
    Professional Paper 1395 (1987), chapter 4.
    """
    phi, e2 = math.radians(latitude), FLATTENING * (2 - FLATTENING)
    root = 1 - e2 * math.sin(phi) ** 2
    meridian, across = EQUATOR * (1 - e2) / root**1.5, EQUATOR / math.sqrt(root)
    return math.radians(across * math.cos(phi)), math.radians(meridian)


def projection_of(bbox: BBox, cell: float, size: tuple[int, int], middle: bool = False) -> GridProjection:
    """The cells that a box of the world holds, as many as come nearest to it.

    Degrees become metres by the equidistant cylindrical projection, with the latitude of the middle as its standard
    parallel (Snyder, chapter 12). What is 10 km further north or south is 0.3 % too wide or narrow at 60 degrees, and
    less nearer to the equator.

    Args:
        bbox: The box.
        cell: Metres along the side of a cell.
        size: The most columns and rows.
        middle: Whether to take the middle of a box with more, and not to refuse it.

    Raises:
        InvalidValueError: if it is no box, or holds too few or too many cells.
    """
    check_bbox(bbox)
    west, south, east, north = bbox
    at = (west + east) / 2, (south + north) / 2
    degree = metres_per_degree(at[1])
    wanted = round((east - west) * degree[0] / cell), round((north - south) * degree[1] / cell)
    metres = f"{(east - west) * degree[0]:.0f} x {(north - south) * degree[1]:.0f} metres"
    holds = f"{metres} are {wanted[0]} x {wanted[1]} cells of {cell:g} metres"
    if min(wanted) < MIN_SIDE:
        raise InvalidValueError(
            f"{holds}; a city has at least {MIN_SIDE} x {MIN_SIDE}: take a larger box or smaller cells"
        )
    columns, rows = min(wanted[0], size[0]), min(wanted[1], size[1])
    if not middle and (columns, rows) != wanted:
        raise InvalidValueError(f"--bbox: {holds}; --size allows {size[0]} x {size[1]}")
    half = columns * cell / 2 / degree[0], rows * cell / 2 / degree[1]
    # OpenStreetMap keeps seven decimals.
    box = at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1]
    rounded = tuple(round(side, 7) for side in box)
    return GridProjection((rounded[0], rounded[1], rounded[2], rounded[3]), columns, rows, cell)


def paint_area(mask: Mask, rings: Sequence[Points]) -> None:
    """Set each sample inside an area, by the even-odd rule: inside an odd number of rings.

    A sample is inside a ring if the way to its left crosses the ring an odd number of times (ray casting); the
    crossings of a row of samples are found for all its samples at once.

    Args:
        mask: bool[height, width], changed in place.
        rings: Outer and inner ones, each closed: its last point is its first.
    """
    start = np.concatenate([ring[:-1] for ring in rings])
    end = np.concatenate([ring[1:] for ring in rings])
    height, width = mask.shape
    ys = np.sort([start[:, 1], end[:, 1]], axis=0)
    # The rows of samples with lower y <= y of the row < upper y, so that a corner counts once.
    first, stop = np.clip(np.ceil(ys - 0.5), 0, height).astype(np.int64)
    crossing = np.flatnonzero(stop > first)
    if not len(crossing):
        return
    xs = np.concatenate([start[crossing, 0], end[crossing, 0]])
    left, right = np.clip([np.floor(xs.min()) - 1, np.ceil(xs.max()) + 1], 0, width).astype(int).tolist()
    top, bottom = int(first[crossing].min()), int(stop[crossing].max())
    flips = np.zeros((bottom - top, right - left + 1), np.bool_)
    for part in np.array_split(crossing, -(-len(crossing) // SIDES)):
        count = stop[part] - first[part]
        side = np.repeat(part, count)
        row = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count) + first[side]
        (x, y), (dx, dy) = start[side].T, (end[side] - start[side]).T
        at = x + (row + 0.5 - y) / dy * dx
        column = np.clip(np.ceil(at - 0.5), left, right).astype(np.int64)
        np.logical_xor.at(flips, (row - top, column - left), True)
    mask[top:bottom, left:right] |= np.logical_xor.accumulate(flips, axis=1)[:, :-1]


def paint_line(mask: Mask, line: Points, width: float) -> None:
    """Set each sample that lies on a line of this width, whose parts end in squares.

    Args:
        mask: bool[height, width], changed in place.
        line: Its points, at least two.
        width: In samples.
    """
    for start, end in _parts(line, mask.shape, width):
        along = (end - start) / np.hypot(*(end - start)) * width / 2
        aside = along[::-1] * (1, -1)
        corners = [start - along - aside, end + along - aside, end + along + aside, start - along + aside]
        paint_area(mask, [np.array([*corners, corners[0]])])


def water_beside(coasts: Sequence[Points], shape: tuple[int, int]) -> Mask:
    """Which samples lie in the water: to the right of the nearest coast; none where there is no coast.

    Where two parts of a coast are equally near, at a corner, the one counts that faces the sample more squarely.

    Args:
        coasts: Lines with land to their left and water to their right, y growing downwards.
        shape: (height, width) of the raster.

    Returns:
        bool[height, width]
    """
    height, width = shape
    near, square = np.full(shape, np.inf), np.zeros(shape)
    side = np.zeros(shape, np.int8)  # 1 for water, -1 for land, 0 for not known yet
    for start, end in (part for coast in coasts for part in _parts(coast, shape, 2 * REACH)):
        x0, y0, dx, dy = *start.tolist(), *(end - start).tolist()
        low, high = np.minimum(start, end) - REACH - 0.5, np.maximum(start, end) + REACH + 0.5
        left, right = np.clip([low[0], high[0]], 0, width).astype(int).tolist()
        top, bottom = np.clip([low[1], high[1]], 0, height).astype(int).tolist()
        window = slice(top, bottom), slice(left, right)
        down, along = np.mgrid[window]
        x, y, length = along + 0.5 - x0, down + 0.5 - y0, math.hypot(dx, dy)
        share = np.clip((x * dx + y * dy) / length**2, 0, 1)
        far = np.hypot(x - share * dx, y - share * dy)
        across = (dx * y - dy * x) / length
        squarely = np.abs(across) / np.maximum(far, 1e-12)
        tie = np.abs(far - near[window]) <= 1e-9
        closer = (far <= REACH) & ((tie & (squarely > square[window])) | (~tie & (far < near[window])))
        near[window][closer] = far[closer]
        square[window][closer] = squarely[closer]
        side[window][closer] = np.where(across[closer] > 0, 1, -1)
    return _spread(side) > 0


def _parts(line: Points, shape: tuple[int, ...], width: float) -> list[tuple[Points, Points]]:
    """The parts of a line, each as start and end, that may touch the raster; those of no length are left out."""
    low, high = np.minimum(line[:-1], line[1:]) - width, np.maximum(line[:-1], line[1:]) + width
    touches = (high > 0).all(axis=1) & (low < shape[::-1]).all(axis=1) & (line[:-1] != line[1:]).any(axis=1)
    return [(line[i], line[i + 1]) for i in np.flatnonzero(touches)]


def _spread(side: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    """The same, each 0 replaced by what a nearest neighbour is that is none, by steps along rows and columns."""
    height, width = side.shape
    cells: list[int] = side.ravel().tolist()
    pending = deque(i for i, known in enumerate(cells) if known)
    while pending:
        i = pending.popleft()
        y, x = divmod(i, width)
        beside = (i - 1, x > 0), (i + 1, x < width - 1), (i - width, y > 0), (i + width, y < height - 1)
        for to, inside in beside:
            if inside and not cells[to]:
                cells[to] = cells[i]
                pending.append(to)
    return np.reshape(np.array(cells, np.int8), side.shape)
