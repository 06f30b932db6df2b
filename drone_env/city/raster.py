"""Convert degrees to cells, and rasterise areas, lines and coasts.

Raster coordinates: corners are whole numbers, and the sample of column x and row y is at (x + 0.5, y + 0.5). Points far
outside cost nothing.
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
"""Maximum number of sides of an area that are painted together, to bound the memory."""
REACH = 1.5
"""Maximum distance in cells at which a coast decides between water and land; other cells copy a neighbour."""


class GridProjection(NamedTuple):
    """A grid of cells over the world, north up."""

    bbox: BBox
    columns: int
    rows: int
    cell: float
    """Metres along the side of a cell."""

    def to_cells(self, degrees: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Convert float64[n, 2], (longitude, latitude) in degrees, to (x, y) in cells from the north-western corner."""
        west, south, east, north = self.bbox
        scale = self.columns / (east - west), -self.rows / (north - south)
        return (degrees - (west, north)) * scale


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return the metres of a degree of longitude and of a degree of latitude.

    From the radii of curvature of the ellipsoid: Snyder, "Map Projections: A Working Manual", U.S. Geological Survey
    Professional Paper 1395 (1987), chapter 4.
    """
    phi, e2 = math.radians(latitude), FLATTENING * (2 - FLATTENING)
    root = 1 - e2 * math.sin(phi) ** 2
    meridian, across = EQUATOR * (1 - e2) / root**1.5, EQUATOR / math.sqrt(root)
    return math.radians(across * math.cos(phi)), math.radians(meridian)


def projection_of(bbox: BBox, cell: float, size: tuple[int, int], middle: bool = False) -> GridProjection:
    """Return the grid that fits a bounding box best.

    Degrees become metres by the equidistant cylindrical projection, with the latitude of the middle as its standard
    parallel (Snyder, chapter 12). At 60 degrees, widths 10 km further north or south are off by 0.3 %, nearer to the
    equator by less.

    Args:
        bbox: The bounding box.
        cell: Side of a cell in metres.
        size: Maximum number of columns and rows.
        middle: Whether to take the middle of a larger box instead of raising.
    """
    check_bbox(bbox)
    west, south, east, north = bbox
    at = (west + east) / 2, (south + north) / 2
    degree = metres_per_degree(at[1])
    count = round((east - west) * degree[0] / cell), round((north - south) * degree[1] / cell)
    have = f"the area has {count[0]} x {count[1]} cells of {cell:g} metres"
    if min(count) < MIN_SIDE:
        raise InvalidValueError(f"{have}, needed are {MIN_SIDE} x {MIN_SIDE}: use a larger --bbox or a smaller --cell")
    columns, rows = min(count[0], size[0]), min(count[1], size[1])
    if not middle and (columns, rows) != count:
        raise InvalidValueError(f"{have}; --size allows {size[0]} x {size[1]}")
    half = columns * cell / 2 / degree[0], rows * cell / 2 / degree[1]
    # OpenStreetMap stores seven decimals.
    box = at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1]
    rounded = tuple(round(side, 7) for side in box)
    return GridProjection((rounded[0], rounded[1], rounded[2], rounded[3]), columns, rows, cell)


def paint_area(mask: Mask, rings: Sequence[Points]) -> None:
    """Set each sample inside an area, by the even-odd rule and ray casting to the left.

    Args:
        mask: bool[height, width], changed in place.
        rings: Outer and inner rings, each closed: its last point is its first.
    """
    start = np.concatenate([ring[:-1] for ring in rings])
    end = np.concatenate([ring[1:] for ring in rings])
    height, width = mask.shape
    ys = np.sort([start[:, 1], end[:, 1]], axis=0)
    # Rows with lower y <= y < upper y, so that a corner counts once.
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
    """Set each sample on a line with square ends.

    Args:
        mask: bool[height, width], changed in place.
        line: At least two points.
        width: Width of the line in samples.
    """
    for start, end in _parts(line, mask.shape, width):
        along = (end - start) / np.hypot(*(end - start)) * width / 2
        aside = along[::-1] * (1, -1)
        corners = [start - along - aside, end + along - aside, end + along + aside, start - along + aside]
        paint_area(mask, [np.array([*corners, corners[0]])])


def water_beside(coasts: Sequence[Points], shape: tuple[int, int]) -> Mask:
    """Return bool[height, width]: the samples to the right of the nearest coast; none without a coast.

    If two segments are equally near, at a corner, the one that faces the sample more squarely decides.

    Args:
        coasts: Lines with land to their left and water to their right, y growing downwards.
        shape: (height, width) of the raster.
    """
    height, width = shape
    near, square = np.full(shape, np.inf), np.zeros(shape)
    side = np.zeros(shape, np.int8)  # 1 for water, -1 for land, 0 for unknown
    for start, end in (part for coast in coasts for part in _parts(coast, shape, 2 * REACH)):
        x0, y0, dx, dy = *start.tolist(), *(end - start).tolist()
        low, high = np.minimum(start, end) - REACH - 0.5, np.maximum(start, end) + REACH + 0.5
        left, right = np.clip([low[0], high[0]], 0, width).astype(int).tolist()
        top, bottom = np.clip([low[1], high[1]], 0, height).astype(int).tolist()
        window = slice(top, bottom), slice(left, right)
        down, along = np.mgrid[window]
        x, y, length = along + 0.5 - x0, down + 0.5 - y0, math.hypot(dx, dy)
        share = np.clip((x * dx + y * dy) / length**2, 0, 1)
        distance = np.hypot(x - share * dx, y - share * dy)
        across = (dx * y - dy * x) / length
        squarely = np.abs(across) / np.maximum(distance, 1e-12)
        tie = np.abs(distance - near[window]) <= 1e-9
        nearer = (distance <= REACH) & ((tie & (squarely > square[window])) | (~tie & (distance < near[window])))
        near[window][nearer] = distance[nearer]
        square[window][nearer] = squarely[nearer]
        side[window][nearer] = np.where(across[nearer] > 0, 1, -1)
    return _spread(side) > 0


def _parts(line: Points, shape: tuple[int, ...], width: float) -> list[tuple[Points, Points]]:
    """Return start and end of the segments that may touch the raster; those of length 0 are dropped."""
    low, high = np.minimum(line[:-1], line[1:]) - width, np.maximum(line[:-1], line[1:]) + width
    touches = (high > 0).all(axis=1) & (low < shape[::-1]).all(axis=1) & (line[:-1] != line[1:]).any(axis=1)
    return [(line[i], line[i + 1]) for i in np.flatnonzero(touches)]


def _spread(side: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
    """Replace each 0 by the value of the nearest other cell, in steps along rows and columns."""
    padded = np.pad(side, 1, constant_values=2)
    cells: list[int] = padded.ravel().tolist()
    pending = deque(i for i, value in enumerate(cells) if value in (-1, 1))
    while pending:
        i = pending.popleft()
        for neighbour in (i - 1, i + 1, i - padded.shape[1], i + padded.shape[1]):
            if cells[neighbour] == 0:
                cells[neighbour] = cells[i]
                pending.append(neighbour)
    return np.reshape(np.array(cells, np.int8), padded.shape)[1:-1, 1:-1]
