"""A city from an extract of OpenStreetMap. Needs the extra `city`.

The first pass over a file stores the coordinates of its nodes, the second reads its ways, so its order does not matter.
"""

import logging
import re
from cmath import phase
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import degrees
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.city.city_file import MAX_NAMES, MAX_SIDE, MAX_TEXT, MIN_SIDE, BBox, City
from drone_env.city.raster import GridProjection, Points, paint_area, paint_line, projection_of, water_beside
from drone_env.core.cells import Cell
from drone_env.core.terrain import Name
from drone_env.errors import InvalidValueError, abbreviate, needs
from drone_env.toml_text import parse_toml

log = logging.getLogger(__name__)

ATTRIBUTION = "© OpenStreetMap contributors, ODbL-1.0"
MAX_FILE = 128 << 20
"""Bytes of an extract: all its nodes are held in memory."""
MAX_CUT = 0.1
"""Maximum share of ways and areas without all their nodes.

A file with complete ways has up to 7 % on squares of 400 to 900 metres: areas of several ways that reach across its
border. One whose ways end at the border (`osmium extract --strategy simple`) has 17 to 54 %.
"""
MOST_STREETS = 24
"""Names of streets on a map: those of the longest."""
STRAIGHT = 8.0
"""Cells around the middle of a street that give the direction of its name."""
MIN_CELL, MAX_CELL = 1.0, 100.0
"""Metres along the side of a cell."""
FINE = 16
"""Samples along the side of a cell."""
REMARK = re.compile(rb"<remark>(.*?)</remark>", re.DOTALL)
LONGEST_REMARK = 4096
TABLE = Path(__file__).with_name("layers.toml")
ALLOWED = "allowed are XML (.osm, .osm.gz, .osm.bz2) and PBF (.osm.pbf) of OpenStreetMap"
COMPLETE = "include them: in Overpass by `(...; >;); out;`, in osmium by `extract --strategy smart`"
HISTORY = "it contains several versions of an object: keep the newest by `osmium time-filter`"
Place = tuple[float, float]
"""Longitude and latitude in degrees."""
Line = Sequence[Place | None]
"""The places of the nodes of a way; None for a node that is not in the file."""
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


class Match(NamedTuple):
    """The layer that an object belongs to."""

    layer: Layer
    form: str
    """`points`, `areas`, `lines` or `coasts`."""
    rule: Rule


@dataclass
class Source:
    """A file that osmium reads, and its module."""

    osmium: Any
    file: str

    def objects(self, types: Any, *filters: Any) -> Iterator[Any]:
        """Yield the objects of some types that pass some filters of osmium."""
        processor = self.osmium.FileProcessor(self.file, types)
        for keep in filters:
            processor.with_filter(keep)
        for item in processor:
            if item.deleted:
                raise InvalidValueError(HISTORY)
            yield item

    @cached_property
    def new_nodes(self) -> Mapping[int, Place]:
        """Places by negative id, which editors give new nodes, and osmium does not store."""
        new = (node for node in self.objects(self.osmium.osm.NODE) if node.id < 0)
        return {node.id: (node.lon, node.lat) for node in new if node.location.valid()}

    def places(self, nodes: Iterable[Any]) -> Line:
        """Return the places of the nodes of a way."""
        located = ((node.ref, node.location) for node in nodes)
        return [(at.lon, at.lat) if at.valid() else self.new_nodes.get(ref) if ref < 0 else None for ref, at in located]

    def extent(self) -> BBox:
        """Return west, south, east, north of all nodes in degrees.

        Raises:
            InvalidValueError: if there are none.
        """
        nodes = (node.location for node in self.objects(self.osmium.osm.NODE))
        places = [(at.lon, at.lat) for at in nodes if at.valid()]
        if not places:
            raise InvalidValueError(f"it contains no node with a place; {COMPLETE}")
        (west, south), (east, north) = np.min(places, axis=0).tolist(), np.max(places, axis=0).tolist()
        return west, south, east, north

    def covered(self) -> BBox:
        """Return what the file covers: its bounds, else its nodes."""
        header = self.osmium.io.Reader(self.file, self.osmium.osm.NOTHING).header()
        if header.has_multiple_object_versions:
            raise InvalidValueError(HISTORY)
        box = header.box()
        if not box.valid():
            return self.extent()
        return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def import_city(path: Path, bbox: BBox | None = None, cell: float = 16.0, size: tuple[int, int] = (64, 64)) -> City:
    """Convert an extract to a city. Equal files give equal cities.

    Logs a warning if ways or areas lack nodes.

    Args:
        path: The extract: XML, also compressed with gzip or bzip2, or PBF.
        bbox: West, south, east, north in degrees; without it, the middle of the file.
        cell: Metres along the side of a cell.
        size: Maximum number of columns and rows.

    Raises:
        InvalidValueError: if the file cannot be read, contains nothing there, or lacks too many nodes there, or if the
            box has more cells than `size`.
        MissingPackageError: if the extra `city` is not installed.
        OSError: if the file cannot be opened.
    """
    columns, rows = size
    if not (MIN_SIDE <= min(size) and max(size) <= MAX_SIDE):
        raise InvalidValueError(f"--size takes two numbers of {MIN_SIDE} to {MAX_SIDE}, got {columns} {rows}")
    if not MIN_CELL <= cell <= MAX_CELL:
        raise InvalidValueError(f"--cell must be {MIN_CELL:g} to {MAX_CELL:g} metres, got {cell:g}")
    with _opened(path) as source:
        projection = projection_of(bbox or source.covered(), cell, size, middle=bbox is None)
        found = Collection(projection)
        _collect(found, source)
        if not found.cut and not found.matched:
            raise InvalidValueError(
                f"no layer has anything there; the file covers {' '.join(f'{side:.9g}' for side in source.extent())}"
            )
        if found.cut:
            share = f"{len(found.cut)} of {len(found.objects)} ways and areas"
            lacking = f"{share} lack nodes ({', '.join([*found.cut][:3])})"
            if len(found.cut) > MAX_CUT * len(found.objects):
                raise InvalidValueError(f"{lacking}; {COMPLETE}, or select a smaller --bbox")
            log.warning("%s: %s: the city lacks these areas, and these ways have gaps", path, lacking)
    grid = np.full((projection.rows, projection.columns), Cell.ROAD, np.uint8)
    for layer in reversed(layers()):
        grid[_claimed(layer, found)] = layer.kind
    return City(grid, ATTRIBUTION, cell, projection.bbox, names=found.names())


@lru_cache(maxsize=1)
def _table() -> dict[str, Any]:
    return parse_toml(TABLE.read_bytes())


@lru_cache(maxsize=1)
def layers() -> tuple[Layer, ...]:
    """Load the layers in the order of the table."""
    return tuple(map(_layer, _table()["layer"]))


def _layer(row: Mapping[str, Any]) -> Layer:
    rules = {form: tuple(map(_rule, row.get(form, ()))) for form in ("points", "areas", "coasts", "unless")}
    lines = {_rule(text): width for text, width in row.get("lines", {}).items()}
    return Layer(row["name"], Cell[row["kind"].upper()], row.get("share", 1.0), lines=lines, **rules)


def _rule(text: str) -> Rule:
    pairs = (pair.split("=") for pair in text.split())
    return tuple((key, value) for key, value in pairs)


def _match(tags: Mapping[str, str], *forms: str) -> Match | None:
    """Return the first layer that an object with these tags belongs to, in the first form that has one."""
    for form in forms:
        for layer in layers():
            rule = next((rule for rule in getattr(layer, form) if _matches(rule, tags)), None)
            if rule is not None and not any(_matches(excluded, tags) for excluded in layer.unless):
                return Match(layer, form, rule)
    return None


def _matches(rule: Rule, tags: Mapping[str, str]) -> bool:
    return all(tags.get(key, "no") != "no" if value == "*" else tags.get(key) == value for key, value in rule)


@contextmanager
def _opened(path: Path) -> Generator[Source, None, None]:
    """Yield the source; errors inside the `with` name the path."""
    with needs("city"):
        import osmium
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - LONGEST_REMARK))
        remark = REMARK.search(file.read())
    if size > MAX_FILE:
        cut = "cut it with `osmium extract --bbox WEST,SOUTH,EAST,NORTH`"
        raise InvalidValueError(f"{path} has {size >> 20} MiB, allowed are {MAX_FILE >> 20}: {cut}")
    if remark is not None:
        raise InvalidValueError(f"{path}: Overpass did not finish: {abbreviate(remark[1].strip().decode())}")
    try:
        yield Source(osmium, str(path))
    except InvalidValueError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    except (RuntimeError, ValueError, osmium.InvalidLocationError) as error:
        raise InvalidValueError(f"{path}: it is cut short, damaged or of another format: {error}; {ALLOWED}") from None


class Collection:
    """The geometry in a grid."""

    def __init__(self, grid: GridProjection) -> None:
        self.grid = grid
        self.matched: list[tuple[Match, list[Points]]] = []
        """What reaches into the grid: lines in cells, those around an area and its holes in any order."""
        self.objects: set[str] = set()
        """Type and id of each way and area."""
        self.cut: dict[str, None] = {}
        """Those of them without all their nodes."""
        self.districts: dict[str, Name] = {}
        self.streets: dict[str, list[Points]] = {}
        """Lines of the streets by name."""

    def names(self) -> tuple[Name, ...]:
        """The names of the districts, and of the longest streets, longest first."""
        found = [street for text, lines in self.streets.items() if lines and (street := self._street(text, lines))]
        longest = [name for _, name in sorted(found, key=lambda street: (-street[0], street[1]))[:MOST_STREETS]]
        named = [*self.districts.values(), *longest]
        return tuple(name for name in named if name.text.isprintable() and len(name.text) <= MAX_TEXT)[:MAX_NAMES]

    def _street(self, text: str, lines: Sequence[Points]) -> tuple[float, Name] | None:
        """Measure a street in the grid, and place its name at the part nearest to its middle."""
        start, end = np.concatenate([line[:-1] for line in lines]), np.concatenate([line[1:] for line in lines])
        middle, along = (start + end) / 2, end - start
        inside = ((middle >= 0) & (middle < (self.grid.columns, self.grid.rows))).all(axis=1)
        middle, along = middle[inside], along[inside]
        lengths = np.hypot(*along.T)
        if not lengths.sum():
            return None
        apart = np.hypot(*(middle - np.average(middle, axis=0, weights=lengths)).T)
        x, y = middle[apart.argmin()].tolist()
        near = np.hypot(*(middle - (x, y)).T) <= STRAIGHT
        # Of double angles, because opposite directions are equal.
        double = complex((lengths * np.exp(2j * np.arctan2(*along.T[::-1])))[near].sum())
        return lengths.sum(), Name(text, round(x, 1), round(y, 1), round(degrees(phase(double) / 2)))

    def holds(self, place: Points) -> bool:
        """Return whether a point, float64[2] in cells, is in the grid."""
        return bool((place >= 0).all() and (place < (self.grid.columns, self.grid.rows)).all())

    def add(
        self, name: str, tags: Mapping[str, str], forms: Sequence[str], lines: Sequence[Line], lost: int = 0
    ) -> None:
        """Add a way or area, unless it is outside or belongs to no layer.

        Args:
            name: Its type and id.
            tags: Its tags.
            forms: Forms that its geometry allows.
            lines: Its ways.
            lost: Number of its ways that are not in the file.
        """
        known = [place for line in lines for place in line if place is not None]
        # Most objects of a large extract end here, so this check comes first.
        if known and _outside(known, self.grid):
            return
        parts = [self.grid.to_cells(np.array(part)) for line in lines for part in _known_parts(line)]
        if (street := tags.get("name")) and "lines" in forms and tags.get("highway") in _table()["names"]["highway"]:
            self.streets.setdefault(street, []).extend(parts)
        if (match := _match(tags, *forms)) is None:
            return
        self.objects.add(name)
        area = match.form in ("areas", "points")
        loose: set[Place | None] = set()  # ends of lines that no other line continues
        for line in lines if area else ():
            loose ^= {line[0]} ^ {line[-1]}
        if not known or lost or loose or any(None in line for line in lines):
            self.cut[name] = None
            parts = [] if area else parts
        if match.form == "points" and parts:
            corners = np.concatenate(parts)
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            parts = [middle[None]] if self.holds(middle) else []
        if parts:
            self.matched.append((match, parts))


def _collect(found: Collection, source: Source) -> None:
    """Read what a file contains of a grid."""
    osmium = source.osmium
    rules = [rule for layer in layers() for rule in (*layer.points, *layer.areas, *layer.lines, *layer.coasts)]
    keys = {rule[0][0] for rule in rules} | _table()["names"].keys()
    store = osmium.NodeLocationsForWays(osmium.index.create_map("flex_mem"))
    store.ignore_errors()
    relations: list[tuple[str, Mapping[str, str], list[int]]] = []
    for item in source.objects(osmium.osm.NODE | osmium.osm.RELATION, store, osmium.filter.KeyFilter(*sorted(keys))):
        tags = {tag.k: tag.v for tag in item.tags}
        if item.is_relation():
            if tags.get("type") in ("multipolygon", "boundary"):
                ways = dict.fromkeys(member.ref for member in item.members if member.type == "w")
                relations.append((f"relation {item.id}", tags, [*ways]))
        elif item.location.valid():
            place = found.grid.to_cells(np.array([item.lon, item.lat]))
            if not found.holds(place):
                continue
            if match := _match(tags, "points"):
                found.matched.append((match, [place[None]]))
            if tags.get("place") in _table()["names"]["place"] and "name" in tags:
                x, y = place.tolist()
                found.districts[tags["name"]] = Name(tags["name"], round(x, 1), round(y, 1))
    members: dict[int, Line] = {way: () for _, _, ways in relations for way in ways}
    for way in source.objects(osmium.osm.WAY, store):
        tags = {tag.k: tag.v for tag in way.tags}
        if way.id in members or not keys.isdisjoint(tags):
            line = source.places(way.nodes)
            if way.id in members:
                members[way.id] = line
            closed = way.is_closed() or not line
            forms = (
                ("areas", "points", "lines", "coasts") if closed and tags.get("area") != "no" else ("lines", "coasts")
            )
            found.add(f"way {way.id}", tags, forms, [line])
    for name, tags, ways in relations:
        lines = [line for way in ways if (line := members[way])]
        found.add(name, tags, ("areas", "points"), lines, len(ways) - len(lines))


def _known_parts(line: Line) -> list[list[Place]]:
    """Split a line at nodes that are not in the file."""
    parts: list[list[Place]] = [[]]
    for place in line:
        if place is None:
            parts.append([])
        else:
            parts[-1].append(place)
    return [part for part in parts if len(part) > 1]


def _outside(places: Sequence[Place], grid: GridProjection) -> bool:
    """Return whether the bounding box of places does not meet the grid."""
    west, south, east, north = grid.bbox
    lons, lats = [lon for lon, _ in places], [lat for _, lat in places]
    return max(lons) <= west or min(lons) >= east or max(lats) <= south or min(lats) >= north


def _claimed(layer: Layer, found: Collection) -> npt.NDArray[np.bool_]:
    """bool[rows, columns]: the cells that a layer claims."""
    grid, forms = (
        found.grid,
        {form: list[tuple[Rule, list[Points]]]() for form in ("areas", "lines", "coasts", "points")},
    )
    for match, parts in found.matched:
        if match.layer is layer:
            forms[match.form].append((match.rule, parts))
    claimed = np.zeros((grid.rows, grid.columns), np.bool_)
    if forms["areas"] or forms["lines"]:
        covered = np.zeros((grid.rows * FINE, grid.columns * FINE), np.bool_)
        for _, rings in forms["areas"]:
            paint_area(covered, [ring * FINE for ring in rings])
        for rule, lines in forms["lines"]:
            for line in lines:
                paint_line(covered, line * FINE, layer.lines[rule] / grid.cell * FINE)
        samples = np.reshape(covered, (grid.rows, FINE, grid.columns, FINE)).sum(axis=(1, 3))
        claimed |= samples >= layer.share * FINE**2
    if forms["coasts"]:
        claimed |= water_beside([line for _, lines in forms["coasts"] for line in lines], claimed.shape)
    for _, [place] in forms["points"]:
        x, y = place[0].astype(int)
        claimed[y, x] = True
    return claimed
