"""What an extract of OpenStreetMap holds inside a grid, layer by layer. Needs the extra `city`.

A file is read as a stream, by osmium. It keeps the coordinates of all nodes, and of what they make up only what reaches
into the grid is kept here.
"""

import os
import sys
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drone_env.city.city_file import BBox
from drone_env.city.raster import GridProjection, Points
from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError, needs
from drone_env.files import open_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ATTRIBUTION = "© OpenStreetMap contributors"
LICENCE = "ODbL-1.0"
FORMATS = {".osm.pbf": "pbf", ".pbf": "pbf", ".osm": "xml", ".osm.xml": "xml"}
MAX_FILE = 128 << 20
"""Bytes of an extract: all its nodes are held in memory."""
Place = tuple[float, float]
"""Longitude and latitude in degrees."""
TABLE = Path(__file__).with_name("layers.toml")
Rule = tuple[tuple[str, str], ...]
"""(key, value) of the tags that must all hold; the value `*` stands for any but `no`."""


class Layer(NamedTuple):
    """One layer of the table; `layers.toml` says what its parts mean."""

    name: str
    kind: Cell
    share: float
    points: tuple[Rule, ...]
    areas: tuple[Rule, ...]
    lines: tuple[tuple[Rule, float], ...]
    coasts: tuple[Rule, ...]
    unless: tuple[Rule, ...]

    def takes(self, form: str, tags: Mapping[str, str]) -> bool:
        """Whether a thing of this form, `points`, `areas` or `coasts`, belongs here."""
        return any(holds(rule, tags) for rule in getattr(self, form)) and not self._leaves_out(tags)

    def width(self, tags: Mapping[str, str]) -> float | None:
        """The width in metres of a line that belongs here; None for any other."""
        width = next((width for rule, width in self.lines if holds(rule, tags)), None)
        return None if width is None or self._leaves_out(tags) else width

    def _leaves_out(self, tags: Mapping[str, str]) -> bool:
        return any(holds(rule, tags) for rule in self.unless)


def holds(rule: Rule, tags: Mapping[str, str]) -> bool:
    """Whether a thing with these tags is one that a rule describes."""
    return all(tags.get(key, "no") != "no" if value == "*" else tags.get(key) == value for key, value in rule)


@lru_cache(maxsize=1)
def layers() -> tuple[Layer, ...]:
    """The layers of the table, the one that comes first first."""
    return tuple(map(_layer, tomllib.loads(TABLE.read_text(encoding="utf-8"))["layer"]))


def keys() -> list[str]:
    """The keys by which things are described, those that are only left out not among them."""
    rules = [rule for layer in layers() for rule in (*layer.points, *layer.areas, *layer.coasts)]
    rules += [rule for layer in layers() for rule, _ in layer.lines]
    return sorted({rule[0][0] for rule in rules})


def _layer(row: Mapping[str, Any]) -> Layer:
    forms = {form: tuple(map(_rule, row.get(form, ()))) for form in ("points", "areas", "coasts", "unless")}
    lines = tuple((_rule(text), width) for text, width in row.get("lines", {}).items())
    return Layer(row["name"], Cell[row["kind"].upper()], row.get("share", 1.0), lines=lines, **forms)


def _rule(text: str) -> Rule:
    pairs = (pair.split("=") for pair in text.split())
    return tuple((key, value) for key, value in pairs)


@dataclass
class Found:
    """What belongs to a layer and reaches into the grid; coordinates are (x, y) in cells."""

    points: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    areas: list[list[Points]] = field(default_factory=list[list[Points]])
    """The rings of each area, outer and inner ones."""
    lines: list[tuple[Points, float]] = field(default_factory=list[tuple[Points, float]])
    """Each with its width in metres."""
    coasts: list[Points] = field(default_factory=list[Points])
    things: int = 0
    """How many nodes, ways and relations these are."""


@dataclass
class Extract:
    """All that was found, and what was dropped."""

    layers: dict[str, Found]
    outside: int = 0
    """Things with a key that layers ask for, which do not reach into the grid."""
    broken: int = 0
    """Areas whose rings do not close or lack nodes, and ways of which no two nodes that follow each other are there."""


def extent(path: Path) -> BBox:
    """What an extract covers: the box that it names, else the box around its nodes.

    Raises:
        InvalidValueError: if it holds no node, or cannot be read.
        MissingPackageError: if the extra `city` is not installed.
        OSError: if it cannot be opened.
    """
    with _reading(path) as (osmium, file):
        box = osmium.io.Reader(file, osmium.osm.NOTHING).header().box()
        if box.valid() and box.size() > 0:
            low, high = box.bottom_left, box.top_right
            return low.lon, low.lat, high.lon, high.lat
        nodes = (node.location for node in osmium.FileProcessor(file, osmium.osm.NODE))
        places = np.array([(at.lon, at.lat) for at in nodes if at.valid()])
        if not len(places):
            raise InvalidValueError(f"{path} holds no node: it is empty")
        (west, south), (east, north) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        return west, south, east, north


def read_extract(path: Path, grid: GridProjection) -> Extract:
    """What of an extract lies in a grid.

    Raises:
        InvalidValueError: if it cannot be read, or nothing in it can be used; the message says why.
        MissingPackageError: if the extra `city` is not installed.
        OSError: if it cannot be opened.
    """
    extract = Extract({layer.name: Found() for layer in layers()})
    unclosed: set[tuple[str, int]] = set()
    with _reading(path) as (osmium, file):
        wanted = osmium.filter.KeyFilter(*keys())
        for thing in osmium.FileProcessor(file).with_areas(wanted).with_filter(wanted):
            _sort_in(thing, extract, grid, unclosed)
    extract.broken += len(unclosed)
    found = sum(of_layer.things for of_layer in extract.layers.values())
    if not found and extract.broken > extract.outside:
        why = "it is cut short, or not sorted (`osmium sort` puts nodes before ways)"
        raise InvalidValueError(f"{path}: {extract.broken} of its areas and ways lack nodes: {why}")
    return extract


def _sort_in(thing: Any, extract: Extract, grid: GridProjection, unclosed: set[tuple[str, int]]) -> None:
    """Keep a thing, or count why it is dropped. A way and a relation come before the area that they make up."""
    if thing.is_area():
        origin = "way" if thing.from_way() else "relation", thing.orig_id()
        if origin in unclosed and (rings := list(_rings(thing))):
            unclosed.discard(origin)
            if _outside([place for ring in rings for place in ring], grid):
                extract.outside += 1
            else:
                _keep_area(rings, _tags(thing), extract, grid)
        return
    places = _places([thing] if thing.is_node() else thing.nodes if thing.is_way() else ())
    known = [place for place in places if place is not None]
    # Most of a large extract ends here, so that this is asked first.
    if known and _outside(known, grid):
        extract.outside += 1
        return
    tags = _tags(thing)
    if not thing.is_node() and _can_be_area(thing, tags):
        unclosed.add(("way" if thing.is_way() else "relation", thing.id))
    elif thing.is_way():
        _keep_way(places, tags, extract, grid)
    elif thing.is_node() and (layer := _first("points", tags)):
        _keep_point(known, layer, extract, grid)


def _can_be_area(thing: Any, tags: Mapping[str, str]) -> bool:
    """Whether an area is to come of a way or relation, which belongs to a layer."""
    if _first("areas", tags) is None and _first("points", tags) is None:
        return False
    if thing.is_way():
        return thing.is_closed() and tags.get("area") != "no"
    return tags.get("type") in ("multipolygon", "boundary")


def _keep_area(rings: list[list[Place]], tags: Mapping[str, str], extract: Extract, grid: GridProjection) -> None:
    layer, point = _first("areas", tags), _first("points", tags)
    if layer is not None:
        extract.layers[layer.name].areas.append([grid.to_cells(np.array(ring)) for ring in rings])
        extract.layers[layer.name].things += 1
    elif point is not None:
        (west, east), (south, north) = ((min(side), max(side)) for side in zip(*rings[0], strict=True))
        _keep_point([((west + east) / 2, (south + north) / 2)], point, extract, grid)


def _keep_way(places: list[Place | None], tags: Mapping[str, str], extract: Extract, grid: GridProjection) -> None:
    wide = next(((layer, width) for layer in layers() if (width := layer.width(tags)) is not None), None)
    coast = _first("coasts", tags)
    parts = [grid.to_cells(np.array(part)) for part in _parts(places)]
    if not parts:
        extract.broken += wide is not None or coast is not None
    elif wide is not None:
        layer, metres = wide
        extract.layers[layer.name].lines.extend((part, metres) for part in parts)
        extract.layers[layer.name].things += 1
    elif coast is not None:
        extract.layers[coast.name].coasts.extend(parts)
        extract.layers[coast.name].things += 1


def _keep_point(places: list[Place], layer: Layer, extract: Extract, grid: GridProjection) -> None:
    """Keep a point, the one place of a list, if it lies in a cell."""
    for x, y in grid.to_cells(np.array(places)).tolist() if places else ():
        if 0 <= x < grid.columns and 0 <= y < grid.rows:
            extract.layers[layer.name].points.append((x, y))
            extract.layers[layer.name].things += 1
        else:
            extract.outside += 1


def _parts(places: list[Place | None]) -> list[list[Place]]:
    """The parts of a way that an extract holds: where it leaves the extract, nodes are missing."""
    parts: list[list[Place]] = [[]]
    for place in places:
        if place is not None:
            parts[-1].append(place)
        else:
            parts.append([])
    return [part for part in parts if len(part) > 1]


def _outside(places: list[Place], grid: GridProjection) -> bool:
    """Whether the box around places does not meet the grid."""
    west, south, east, north = grid.bbox
    lons, lats = [lon for lon, _ in places], [lat for _, lat in places]
    return max(lons) <= west or min(lons) >= east or max(lats) <= south or min(lats) >= north


def _first(form: str, tags: Mapping[str, str]) -> Layer | None:
    return next((layer for layer in layers() if layer.takes(form, tags)), None)


def _rings(area: Any) -> Iterator[list[Place]]:
    for outer in area.outer_rings():
        for ring in (outer, *area.inner_rings(outer)):
            yield [place for place in _places(ring) if place is not None]


def _places(nodes: Iterable[Any]) -> list[Place | None]:
    """(longitude, latitude) of nodes; None for those that the extract has not."""
    return [(at.lon, at.lat) if at.valid() else None for at in (node.location for node in nodes)]


def _tags(thing: Any) -> dict[str, str]:
    return {tag.k: tag.v for tag in thing.tags}


@contextmanager
def _reading(path: Path) -> Generator[tuple[Any, Any], None, None]:
    """osmium, and a file for it to read; what it then raises says which file is meant."""
    with needs("city"):
        import osmium
        import osmium.io
    suffix = next((suffix for suffix in FORMATS if path.name.endswith(suffix)), None)
    if suffix is None:
        raise InvalidValueError(f"{path}: an extract of OpenStreetMap ends in {', '.join(FORMATS)}")
    with open_file(path) as opened:
        size = os.fstat(opened.fileno()).st_size
    if size > MAX_FILE:
        cut = "cut a piece out of it by `osmium extract --bbox WEST,SOUTH,EAST,NORTH`"
        raise InvalidValueError(f"{path} has {size >> 20} MiB, at most {MAX_FILE >> 20} are read: {cut}")
    if size == 0:
        raise InvalidValueError(f"{path} is empty")
    try:
        yield osmium, osmium.io.File(str(path), FORMATS[suffix])
    except InvalidValueError:
        raise
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:  # what osmium raises
        raise InvalidValueError(f"{path}: not an extract of OpenStreetMap that can be read: {error}") from None
