"""What an extract of OpenStreetMap holds inside a sheet, layer by layer. Needs the extra `city`.

A file is read as a stream, by osmium. It keeps the coordinates of all nodes, and of what they make up only what reaches
into the sheet is kept here.
"""

import os
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.city.layers import Layer, keys, layers
from drone_env.city.sheet import BBox, Sheet
from drone_env.errors import InvalidValueError, needs
from drone_env.files import open_file

ATTRIBUTION = "© OpenStreetMap contributors"
LICENCE = "ODbL-1.0"
FORMATS = {".osm.pbf": "pbf", ".pbf": "pbf", ".osm": "xml", ".osm.xml": "xml"}
MAX_FILE = 128 << 20
"""Bytes of an extract: all its nodes are held in memory."""
Points = npt.NDArray[np.float64]
Place = tuple[float, float]
"""Longitude and latitude in degrees."""


@dataclass
class Found:
    """What belongs to a layer and reaches into the sheet; coordinates are (x, y) in cells."""

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
    """Things with a key that layers ask for, which do not reach into the sheet."""
    broken: int = 0
    """Areas whose rings do not close or lack nodes, and ways of which no two nodes that follow each other are there."""
    unknown: Counter[str] = field(default_factory=Counter[str])
    """Things that no layer takes though one asks for their key, by `key=value`."""


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


def read_extract(path: Path, sheet: Sheet) -> Extract:
    """What of an extract lies in a sheet.

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
            _sort_in(thing, extract, sheet, unclosed)
    extract.broken += len(unclosed)
    found = sum(of_layer.things for of_layer in extract.layers.values())
    if not found and extract.broken > extract.outside:
        why = "it is cut short, or not sorted (`osmium sort` puts nodes before ways)"
        raise InvalidValueError(f"{path}: {extract.broken} of its areas and ways lack nodes: {why}")
    return extract


def _sort_in(thing: Any, extract: Extract, sheet: Sheet, unclosed: set[tuple[str, int]]) -> None:
    """Keep a thing, or count why it is dropped. A way and a relation come before the area that they make up."""
    if thing.is_area():
        origin = "way" if thing.from_way() else "relation", thing.orig_id()
        if origin in unclosed and (rings := list(_rings(thing))):
            unclosed.discard(origin)
            if _outside([place for ring in rings for place in ring], sheet):
                extract.outside += 1
            else:
                _keep_area(rings, _tags(thing), extract, sheet)
        return
    places = _places([thing] if thing.is_node() else thing.nodes if thing.is_way() else ())
    known = [place for place in places if place is not None]
    # Most of a large extract ends here, so that this is asked first.
    if known and _outside(known, sheet):
        extract.outside += 1
        return
    tags = _tags(thing)
    if not thing.is_node() and _can_be_area(thing, tags):
        unclosed.add(("way" if thing.is_way() else "relation", thing.id))
    elif thing.is_way():
        _keep_way(places, tags, extract, sheet)
    elif thing.is_node() and (layer := _first("points", tags)):
        _keep_point(known, layer, extract, sheet)
    elif thing.is_node() or tags.get("type") in ("multipolygon", "boundary"):
        extract.unknown.update(_described(tags))


def _can_be_area(thing: Any, tags: Mapping[str, str]) -> bool:
    """Whether an area is to come of a way or relation, which belongs to a layer."""
    if _first("areas", tags) is None and _first("points", tags) is None:
        return False
    if thing.is_way():
        return thing.is_closed() and tags.get("area") != "no"
    return tags.get("type") in ("multipolygon", "boundary")


def _keep_area(rings: list[list[Place]], tags: Mapping[str, str], extract: Extract, sheet: Sheet) -> None:
    layer, point = _first("areas", tags), _first("points", tags)
    if layer is not None:
        extract.layers[layer.name].areas.append([sheet.to_cells(np.array(ring)) for ring in rings])
        extract.layers[layer.name].things += 1
    elif point is not None:
        (west, east), (south, north) = ((min(side), max(side)) for side in zip(*rings[0], strict=True))
        _keep_point([((west + east) / 2, (south + north) / 2)], point, extract, sheet)


def _keep_way(places: list[Place | None], tags: Mapping[str, str], extract: Extract, sheet: Sheet) -> None:
    wide = next(((layer, width) for layer in layers() if (width := layer.width(tags)) is not None), None)
    coast = _first("coasts", tags)
    parts = [sheet.to_cells(np.array(part)) for part in _parts(places)]
    if wide is None and coast is None:
        extract.unknown.update(_described(tags))
    elif not parts:
        extract.broken += 1
    elif wide is not None:
        layer, metres = wide
        extract.layers[layer.name].lines.extend((part, metres) for part in parts)
        extract.layers[layer.name].things += 1
    elif coast is not None:
        extract.layers[coast.name].coasts.extend(parts)
        extract.layers[coast.name].things += 1


def _keep_point(places: list[Place], layer: Layer, extract: Extract, sheet: Sheet) -> None:
    """Keep a point, the one place of a list, if it lies in a cell."""
    for x, y in sheet.to_cells(np.array(places)).tolist() if places else ():
        if 0 <= x < sheet.columns and 0 <= y < sheet.rows:
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


def _outside(places: list[Place], sheet: Sheet) -> bool:
    """Whether the box around places does not meet the sheet."""
    west, south, east, north = sheet.bbox
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


def _described(tags: Mapping[str, str]) -> list[str]:
    """`key=value` of the first tag that layers ask for."""
    return [f"{key}={tags[key]}" for key in keys() if key in tags][:1]


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
