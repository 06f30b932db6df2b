"""A city from an extract of OpenStreetMap. Needs the extra `city`.

osmium streams the file and holds the coordinates of all nodes. Only geometry that reaches into the grid is collected.
"""

import os
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.city.city_file import MAX_SIDE, MIN_SIDE, BBox, City
from drone_env.city.raster import GridProjection, Points, paint_area, paint_line, projection_of, water_beside
from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError, needs
from drone_env.files import open_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ATTRIBUTION = "© OpenStreetMap contributors"
LICENCE = "ODbL-1.0"
SUFFIXES = (".osm.pbf", ".pbf", ".osm", ".osm.xml")
MAX_FILE = 128 << 20
"""Bytes of an extract: all its nodes are held in memory."""
MIN_CELL, MAX_CELL = 1.0, 100.0
"""Metres along the side of a cell."""
FINE = 16
"""Samples along the side of a cell."""
TABLE = Path(__file__).with_name("layers.toml")
Place = tuple[float, float]
"""Longitude and latitude in degrees."""
Rule = tuple[tuple[str, str], ...]
"""(key, value) of the tags that must all match; the value `*` matches any but `no`."""


class Layer(NamedTuple):
    """One layer of `layers.toml`, which explains the fields."""

    name: str
    kind: Cell
    share: float
    points: tuple[Rule, ...]
    areas: tuple[Rule, ...]
    lines: Mapping[Rule, float]
    """Width in metres by rule."""
    coasts: tuple[Rule, ...]
    unless: tuple[Rule, ...]


@dataclass
class Geometry:
    """The geometry of one layer that reaches into the grid; coordinates are (x, y) in cells."""

    points: list[Points] = field(default_factory=list[Points])
    areas: list[list[Points]] = field(default_factory=list[list[Points]])
    """The outer and inner rings of each area."""
    lines: list[tuple[Points, float]] = field(default_factory=list[tuple[Points, float]])
    """Each with its width in metres."""
    coasts: list[Points] = field(default_factory=list[Points])


def import_city(path: Path, bbox: BBox | None = None, cell: float = 16.0, size: tuple[int, int] = (64, 64)) -> City:
    """Convert an extract to a city. Equal files give equal cities.

    Args:
        path: The extract (.osm.pbf or .osm).
        bbox: West, south, east, north in degrees; without it, the middle of the file.
        cell: Metres along the side of a cell.
        size: Maximum number of columns and rows.

    Raises:
        InvalidValueError: if the file cannot be read, contains nothing there, or the box has more cells than `size`.
        MissingPackageError: if the extra `city` is not installed.
        OSError: if the file cannot be opened.
    """
    columns, rows = size
    if not (MIN_SIDE <= min(size) and max(size) <= MAX_SIDE):
        raise InvalidValueError(f"--size must be {MIN_SIDE}x{MIN_SIDE} to {MAX_SIDE}x{MAX_SIDE}, got {columns}x{rows}")
    if not MIN_CELL <= cell <= MAX_CELL:
        raise InvalidValueError(f"--cell must be {MIN_CELL:g} to {MAX_CELL:g} metres, got {cell:g}")
    with _opened(path) as (osmium, file):
        projection = projection_of(bbox or _extent(osmium, file), cell, size, middle=bbox is None)
        layered = _read(osmium, file, projection)
        if not any(any(vars(found).values()) for found in layered.values()):
            west, south, east, north = _extent(osmium, file)
            raise InvalidValueError(f"no layer has anything there; the file covers {west} {south} {east} {north}")
    grid = np.full((projection.rows, projection.columns), Cell.ROAD, np.uint8)
    for layer in reversed(layers()):
        grid[_claimed(layer, layered[layer.name], projection)] = layer.kind
    return City(grid, ATTRIBUTION, LICENCE, path.name, cell, projection.bbox)


@lru_cache(maxsize=1)
def layers() -> tuple[Layer, ...]:
    """Load the layers in the order of the table."""
    return tuple(map(_layer, tomllib.loads(TABLE.read_text(encoding="utf-8"))["layer"]))


def _layer(row: Mapping[str, Any]) -> Layer:
    rules = {form: tuple(map(_rule, row.get(form, ()))) for form in ("points", "areas", "coasts", "unless")}
    lines = {_rule(text): width for text, width in row.get("lines", {}).items()}
    return Layer(row["name"], Cell[row["kind"].upper()], row.get("share", 1.0), lines=lines, **rules)


def _rule(text: str) -> Rule:
    pairs = (pair.split("=") for pair in text.split())
    return tuple((key, value) for key, value in pairs)


def _match(form: str, tags: Mapping[str, str]) -> tuple[Layer, Rule] | None:
    """Return the first layer that an object with these tags belongs to, with the rule that matches."""
    for layer in layers():
        rule = next((rule for rule in getattr(layer, form) if _matches(rule, tags)), None)
        if rule is not None and not any(_matches(excluded, tags) for excluded in layer.unless):
            return layer, rule
    return None


def _matches(rule: Rule, tags: Mapping[str, str]) -> bool:
    return all(tags.get(key, "no") != "no" if value == "*" else tags.get(key) == value for key, value in rule)


@contextmanager
def _opened(path: Path) -> Generator[tuple[Any, Any], None, None]:
    """Yield osmium and the file for it; errors inside the `with` name the path."""
    with needs("city"):
        import osmium
        import osmium.io
    if not path.name.endswith(SUFFIXES):
        raise InvalidValueError(f"{path}: an extract of OpenStreetMap ends in {', '.join(SUFFIXES)}")
    with open_file(path) as opened:
        size = os.fstat(opened.fileno()).st_size
    if size > MAX_FILE:
        cut = "cut it with `osmium extract --bbox WEST,SOUTH,EAST,NORTH`"
        raise InvalidValueError(f"{path} has {size >> 20} MiB, allowed are {MAX_FILE >> 20}: {cut}")
    try:
        yield osmium, osmium.io.File(str(path), "pbf" if path.suffix == ".pbf" else "xml")
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:  # osmium's own errors
        raise InvalidValueError(f"{path}: not a readable extract of OpenStreetMap: {error}") from None


def _extent(osmium: Any, file: Any) -> BBox:
    """Return the bounds in the file's header, else the bounds of its nodes."""
    box = osmium.io.Reader(file, osmium.osm.NOTHING).header().box()
    if box.valid() and box.size() > 0:
        low, high = box.bottom_left, box.top_right
        return low.lon, low.lat, high.lon, high.lat
    places = [place for place in _places(osmium.FileProcessor(file, osmium.osm.NODE)) if place is not None]
    if not places:
        raise InvalidValueError("it contains no nodes")
    (west, south), (east, north) = np.min(places, axis=0).tolist(), np.max(places, axis=0).tolist()
    return west, south, east, north


def _read(osmium: Any, file: Any, grid: GridProjection) -> dict[str, Geometry]:
    """Collect the geometry in a grid by the name of its layer."""
    layered = {layer.name: Geometry() for layer in layers()}
    rules = (rule for layer in layers() for rule in (*layer.points, *layer.areas, *layer.lines, *layer.coasts))
    keys = osmium.filter.KeyFilter(*sorted({rule[0][0] for rule in rules}))
    for item in osmium.FileProcessor(file).with_areas(keys).with_filter(keys):
        if item.is_area():
            _add_area(item, layered, grid)
        elif not item.is_relation():  # osmium assembles areas from relations
            _add_node_or_way(item, layered, grid)
    return layered


def _add_area(area: Any, layered: Mapping[str, Geometry], grid: GridProjection) -> None:
    rings: list[list[Place]] = []
    for outer in area.outer_rings():
        for ring in (outer, *area.inner_rings(outer)):
            rings.append([place for place in _places(ring) if place is not None])
    if not rings or _outside([place for ring in rings for place in ring], grid):
        return
    tags = {tag.k: tag.v for tag in area.tags}
    if match := _match("areas", tags):
        layered[match[0].name].areas.append([grid.to_cells(np.array(ring)) for ring in rings])
    elif match := _match("points", tags):
        corners = grid.to_cells(np.array(rings[0]))
        layered[match[0].name].points.append((corners.min(axis=0) + corners.max(axis=0)) / 2)


def _add_node_or_way(item: Any, layered: Mapping[str, Geometry], grid: GridProjection) -> None:
    places = _places([item] if item.is_node() else item.nodes)
    known = [place for place in places if place is not None]
    # Most objects of a large extract end here, so this check comes first.
    if not known or _outside(known, grid):
        return
    tags = {tag.k: tag.v for tag in item.tags}
    point = _match("points", tags)
    if item.is_node():
        if point:
            layered[point[0].name].points.append(grid.to_cells(np.array(known))[0])
    elif item.is_closed() and tags.get("area") != "no" and (point or _match("areas", tags)):
        return  # osmium assembles an area from it
    elif match := _match("lines", tags):
        layer, rule = match
        layered[layer.name].lines.extend((part, layer.lines[rule]) for part in _parts(places, grid))
    elif match := _match("coasts", tags):
        layered[match[0].name].coasts.extend(_parts(places, grid))


def _parts(places: Sequence[Place | None], grid: GridProjection) -> list[Points]:
    """Split a way at nodes that the extract lacks."""
    parts: list[list[Place]] = [[]]
    for place in places:
        if place is None:
            parts.append([])
        else:
            parts[-1].append(place)
    return [grid.to_cells(np.array(part)) for part in parts if len(part) > 1]


def _outside(places: Sequence[Place], grid: GridProjection) -> bool:
    """Return whether the bounding box of places does not meet the grid."""
    west, south, east, north = grid.bbox
    lons, lats = [lon for lon, _ in places], [lat for _, lat in places]
    return max(lons) <= west or min(lons) >= east or max(lats) <= south or min(lats) >= north


def _places(nodes: Iterable[Any]) -> list[Place | None]:
    """Return (longitude, latitude) of nodes; None for those that the extract lacks."""
    return [(at.lon, at.lat) if at.valid() else None for at in (node.location for node in nodes)]


def _claimed(layer: Layer, found: Geometry, projection: GridProjection) -> npt.NDArray[np.bool_]:
    """bool[rows, columns]: the cells that a layer claims."""
    claimed = np.zeros((projection.rows, projection.columns), np.bool_)
    if found.areas or found.lines:
        covered = np.zeros((projection.rows * FINE, projection.columns * FINE), np.bool_)
        for rings in found.areas:
            paint_area(covered, [ring * FINE for ring in rings])
        for line, width in found.lines:
            paint_line(covered, line * FINE, width / projection.cell * FINE)
        samples = np.reshape(covered, (projection.rows, FINE, projection.columns, FINE)).sum(axis=(1, 3))
        claimed |= samples >= layer.share * FINE**2
    if found.coasts:
        claimed |= water_beside(found.coasts, claimed.shape)
    for x, y in found.points:
        if 0 <= x < projection.columns and 0 <= y < projection.rows:
            claimed[int(y), int(x)] = True
    return claimed
