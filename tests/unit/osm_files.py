"""Small extracts of OpenStreetMap, drawn in cells of a known box and written as XML by hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from drone_env.city.raster import metres_per_degree

CELL, COLUMNS, ROWS = 16.0, 6, 4
_EAST, _NORTH = metres_per_degree(60.0)
_WIDE, _HIGH = COLUMNS * CELL / _EAST, ROWS * CELL / _NORTH
BOX = (25.0, 60.0 - _HIGH / 2, 25.0 + _WIDE, 60.0 + _HIGH / 2)
"""West, south, east, north of 6 x 4 cells of 16 metres."""
XY = tuple[float, float]


class Drawing:
    """An extract; its coordinates are (x, y) in cells from the north-western corner."""

    def __init__(self, bounds: bool = True) -> None:
        west, south, east, north = BOX
        box = f'<bounds minlat="{south:.9f}" minlon="{west:.9f}" maxlat="{north:.9f}" maxlon="{east:.9f}"/>'
        self._head = box if bounds else ""
        self._parts: dict[str, list[str]] = {"node": [], "way": [], "relation": []}
        self._nodes: dict[XY, int] = {}

    def node(self, at: XY, **tags: str) -> "Drawing":
        x, y = at
        number = len(self._parts["node"]) + 1
        self._nodes.setdefault(at, number)
        lon, lat = BOX[0] + x / COLUMNS * _WIDE, BOX[3] - y / ROWS * _HIGH
        self._add("node", f'lat="{lat:.9f}" lon="{lon:.9f}"', [], tags)
        return self

    def way(self, *corners: XY, missing: Sequence[int] = (), **tags: str) -> "Drawing":
        """A way; of its nodes, those with the numbers of `missing` are not in the file."""
        for at in corners:
            if at not in self._nodes:
                self.node(at)
        refs = [9000 + i if i in missing else self._nodes[at] for i, at in enumerate(corners)]
        self._add("way", "", [f'<nd ref="{ref}"/>' for ref in refs], tags)
        return self

    def box(self, left: float, top: float, right: float, bottom: float, **tags: str) -> "Drawing":
        return self.way((left, top), (right, top), (right, bottom), (left, bottom), (left, top), **tags)

    def relation(self, members: Mapping[int, str], **tags: str) -> "Drawing":
        """A multipolygon of ways, by their number and role."""
        held = [f'<member type="way" ref="{way}" role="{role}"/>' for way, role in members.items()]
        self._add("relation", "", held, {"type": "multipolygon", **tags})
        return self

    def save(self, path: Path) -> Path:
        parts = [part for kind in self._parts.values() for part in kind]
        path.write_text("\n".join(['<osm version="0.6">', self._head, *parts, "</osm>\n"]), encoding="utf-8")
        return path

    def _add(self, kind: str, attributes: str, inner: list[str], tags: Mapping[str, str]) -> None:
        inner = [*inner, *(f"<tag k={quoteattr(key)} v={quoteattr(value)}/>" for key, value in tags.items())]
        number = len(self._parts[kind]) + 1
        self._parts[kind].append(f'<{kind} id="{number}" version="1" {attributes}>{"".join(inner)}</{kind}>')
