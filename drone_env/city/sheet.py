"""The piece of the world that becomes a city: degrees to cells."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.city.city_file import MAX_SIDE, MIN_SIDE, check_bbox
from drone_env.errors import InvalidValueError

EQUATOR = 6_378_137.0
"""The semi-major axis of the ellipsoid of WGS 84, in metres."""
FLATTENING = 1 / 298.257223563
MIN_CELL, MAX_CELL = 1.0, 100.0
"""Metres along the side of a cell."""
BBox = tuple[float, float, float, float]
"""West, south, east, north in degrees."""


class Sheet(NamedTuple):
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


def sheet_of(bbox: BBox, cell: float, size: tuple[int, int], middle: bool = False) -> Sheet:
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
        fits = max((east - west) * degree[0] / (size[0] + 0.49), (north - south) * degree[1] / (size[1] + 0.49))
        ways = ["take a smaller --bbox"]
        ways += ["a larger --size"] if max(wanted) <= MAX_SIDE else []
        ways += [f"--cell {math.ceil(fits)}"] if math.ceil(fits) <= MAX_CELL else []
        raise InvalidValueError(f"--bbox: {holds}; --size allows {size[0]} x {size[1]}: {', or '.join(ways)}")
    half = columns * cell / 2 / degree[0], rows * cell / 2 / degree[1]
    # OpenStreetMap keeps seven decimals.
    box = at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1]
    rounded = tuple(round(side, 7) for side in box)
    return Sheet((rounded[0], rounded[1], rounded[2], rounded[3]), columns, rows, cell)
