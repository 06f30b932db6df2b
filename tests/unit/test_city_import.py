"""Extracts of OpenStreetMap become cities."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drone_env.city.city_file import city_text, task_of, text_rows
from drone_env.city.openstreetmap import import_city
from drone_env.city.raster import metres_per_degree, paint_area, water_beside
from drone_env.errors import InvalidValueError
from tests.unit.osm_files import BOX, Drawing

SIGNS = ".BT#----P"
"""A letter for each cell."""
RING = ((1, 1), (5, 1), (5, 3), (1, 3), (1, 1))
OPEN = ["......"] * 4


def rows_of(drawing: Drawing, folder: Path) -> list[str]:
    """The rows of a drawing's city."""
    return ["".join(SIGNS[cell] for cell in row) for row in import_city(drawing.save(folder / "town.osm"), BOX).grid]


@pytest.mark.parametrize(
    ("drawing", "rows"),
    [
        pytest.param(
            Drawing().box(1.45, 1.45, 3.55, 3.55, building="yes"),
            ["......", "..B...", ".BBB..", "..B..."],
            id="half of a cell is enough, less is not",
        ),
        pytest.param(
            Drawing().box(0, 0, 6, 4).box(2, 1, 4, 3).relation({1: "outer", 2: "inner"}, building="yes"),
            ["BBBBBB", "BB..BB", "BB..BB", "BBBBBB"],
            id="a courtyard",
        ),
        pytest.param(
            Drawing().box(-50, -50, 1, 50, natural="water").box(5, -9, 900, 9, landuse="basin"),
            ["#....#"] * 4,
            id="areas that reach far out",
        ),
        pytest.param(
            Drawing()
            .node((2.5, 1.5), amenity="charging_station")
            .box(4, 2, 4.4, 2.4, amenity="charging_station")
            .box(1, 1, 5, 3, building="yes"),
            ["......", ".BPBB.", ".BBBP.", "......"],
            id="charging stations, a small area too",
        ),
        pytest.param(
            Drawing()
            .way((0, 2.5), (6, 2.5), railway="rail")
            .way((2.5, 0), (2.5, 4), highway="residential", bridge="yes")
            .node((4.5, 2.5), railway="level_crossing"),
            ["......", "......", "##.#.#", "......"],
            id="a railway with a bridge and a crossing",
        ),
        pytest.param(
            Drawing()
            .way((0, 2.5), (6, 2.5), railway="rail", tunnel="yes")
            .box(1, 1, 2, 2, building="no")
            .box(3, 1, 4, 2, building="roof")
            .way((0, 0), (6, 4), highway="primary")
            .node((0.5, 3.5), natural="tree"),
            [*OPEN[:3], "T....."],
            id="what is left out",
        ),
        pytest.param(
            Drawing().way((3, -1), (3, 5), natural="coastline"), ["###..."] * 4, id="a coast: south, so west is water"
        ),
        pytest.param(
            Drawing().way(*RING[::-1], natural="coastline"),
            ["######", "#....#", "#....#", "######"],
            id="an island",
        ),
    ],
)
def test_a_thing_becomes_these_cells(drawing: Drawing, rows: list[str], tmp_path: Path) -> None:
    assert rows_of(drawing, tmp_path) == rows


TOWN = (
    Drawing()
    .box(0, 0, 4, 4)
    .box(1, 1, 3, 3)
    .relation({1: "outer", 2: "inner"}, building="yes")
    .way((5.5, 0), (5.5, 4), railway="rail")
    .node((4.5, 0.5), amenity="charging_station")
)
TOWN_ROWS = ["BBBBP#", "B..B.#", "B..B.#", "BBBB.#"]
WEST, SOUTH, EAST, NORTH = BOX
MIDDLE = (WEST + EAST) / 2


def bounds(west: float, south: float, east: float, north: float) -> str:
    return f'<bounds minlon="{west}" minlat="{south}" maxlon="{east}" maxlat="{north}"/>'


def with_bounds(*boxes: str) -> Callable[[str], str]:
    return lambda text: re.sub("<bounds[^>]*>", "".join(boxes), text)


def with_objects(objects: str) -> Callable[[str], str]:
    return lambda text: text.replace("</osm>", f"{objects}</osm>")


def numbered(change: Callable[[int], int]) -> Callable[[str], str]:
    """Change the ids."""
    return lambda text: re.sub(r'(id|ref)="(\d+)"', lambda found: f'{found[1]}="{change(int(found[2]))}"', text)


def saved(written: Callable[[str], str | bytes], folder: Path) -> Path:
    """Save the town as another program writes it."""
    path = TOWN.save(folder / "town.osm")
    text = written(path.read_text("utf-8"))
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


WRITTEN: dict[str, Callable[[str], str | bytes]] = {
    "backwards": lambda text: "\n".join([*text.split("\n")[:2], *text.split("\n")[-3:1:-1], "</osm>"]),
    "negative ids": numbered(lambda number: -number),
    "some negative ids": numbered(lambda number: number if number % 3 else -number),
    "large ids": numbered(lambda number: number + 2**62),
}


@pytest.mark.parametrize("case", WRITTEN)
def test_a_file_may_be_written_in_these_ways(case: str, tmp_path: Path) -> None:
    path = saved(WRITTEN[case], tmp_path)
    assert ["".join(SIGNS[cell] for cell in row) for row in import_city(path).grid] == TOWN_ROWS


REFUSED: dict[str, tuple[Callable[[str], str | bytes], str]] = {
    "ways": (
        lambda text: re.sub("<node.*?/node>", "", text),
        r"2 of 2 ways .* \(way 3, relation 1\); .* `\(\.\.\.; >;\); out;`",
    ),
    "a node less": (
        lambda text: re.sub("<node.*?/node>", "", text, count=1),
        r"1 of 2 ways and areas lack nodes \(relation 1\); .* --strategy smart`, or select a smaller --bbox",
    ),
    "an open ring": (lambda text: text.replace('<nd ref="1"/></way>', "</way>"), r"1 of 2 .* \(relation 1\)"),
    "Overpass": (with_objects("<remark>runtime error: timeout</remark>"), "did not finish: .*timeout"),
    "a history": (with_objects('<way id="9" visible="false"/>'), "osmium time-filter"),
    "half": (lambda text: text[:700], "cut short, damaged or of another format: .*unclosed token"),
    "JSON": (lambda text: '{"elements": []}', "not well-formed .* allowed are XML"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_incomplete_or_of_another_kind_is_refused(case: str, tmp_path: Path) -> None:
    written, said = REFUSED[case]
    with pytest.raises(InvalidValueError, match=said):
        import_city(saved(written, tmp_path))


def test_the_few_ways_that_lack_nodes_are_counted_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    drawing = Drawing().way((0, 0.5), (2.1, 0.5), (3.9, 0.5), (6, 0.5), barrier="wall", missing=[2])
    for number in range(8):
        drawing.box(number * 0.1, 3, number * 0.1 + 0.1, 3.1, building="yes")
    with pytest.raises(InvalidValueError, match="1 of 9 ways and areas lack nodes"):
        rows_of(drawing, tmp_path)
    drawing.box(4, 3, 4.1, 3.1, building="yes")
    # Those elsewhere do not count.
    drawing.way((0, 9), (2, 9), (3, 9), barrier="wall", missing=[1])
    assert rows_of(drawing, tmp_path) == ["##....", *OPEN[1:]]
    assert "town.osm: 1 of 10 ways and areas lack nodes (way 1): the city lacks these areas" in caplog.text


def test_without_a_box_the_middle_of_the_file_is_taken(tmp_path: Path) -> None:
    drawing = Drawing().box(2, 1, 4, 3, building="yes")
    city = import_city(drawing.save(tmp_path / "town.osm"), size=(4, 2))
    assert text_rows(city.grid) == ["· 🏢🏢· "] * 2
    again = import_city(tmp_path / "town.osm", city.bbox)
    assert city_text(again) == city_text(city)
    # A file that does not say what it covers is measured.
    drawing = Drawing(bounds=False).node((0, 0)).node((6, 4)).box(2, 1, 4, 3, building="yes")
    city = import_city(drawing.save(tmp_path / "town.osm"))
    assert text_rows(city.grid) == ["· · · · · · ", "· · 🏢🏢· · ", "· · 🏢🏢· · ", "· · · · · · "]
    assert city.bbox == pytest.approx(BOX, abs=1e-7)


def test_districts_and_the_longest_streets_have_their_names(tmp_path: Path) -> None:
    drawing = (
        Drawing()
        .box(5, 3, 6, 4, building="yes")
        .node((2.5, 1.5), place="suburb", name="Kluuvi")
        .node((9, 9), place="suburb", name="elsewhere")
        .node((1, 1), place="house", name="no district")
        .way((0, 3), (2, 3), highway="primary", name="Level")
        .way((2, 3), (4, 3), highway="primary", name="Level")
        .way((-9, 0), (3, 0.5), (5, 2.5), (20, 2.5), highway="residential", name="Bent")
        .way((0, 1), (0.5, 1), highway="footway", name="no street")
        .way((0, 1), (0.5, 1), highway="residential", name="odd\u200bname")
        .way((7, 1), (9, 1), highway="residential", name="outside")
    )
    city = import_city(drawing.save(tmp_path / "town.osm"), BOX)
    assert city.names == (("Kluuvi", 2.5, 1.5, None), ("Level", 1.0, 3.0, 0), ("Bent", 4.0, 1.5, 45))
    assert {name.text for name in task_of(city, "town").terrain.names} == {"Kluuvi", "Level", "Bent"}


@pytest.mark.parametrize(
    ("latitude", "longitude_km", "latitude_km"),
    # National Geospatial-Intelligence Agency, "Length of a degree of latitude and longitude".
    [(0, 111.320, 110.574), (30, 96.486, 110.852), (45, 78.847, 111.132), (60, 55.800, 111.412)],
)
def test_the_length_of_a_degree(latitude: float, longitude_km: float, latitude_km: float) -> None:
    metres = metres_per_degree(latitude)
    assert metres == (pytest.approx(1000 * longitude_km, abs=0.6), pytest.approx(1000 * latitude_km, abs=0.6))


def test_the_water_of_a_jagged_coast_is_what_its_ring_does_not_hold() -> None:
    for seed in range(20):
        random = np.random.default_rng(seed)
        angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        far = random.uniform(3, 9, 12)
        ring = 10 + np.column_stack([far * np.cos(angles), -far * np.sin(angles)])  # land to the left
        ring = np.concatenate([ring, ring[:1]])
        land = np.zeros((20, 20), np.bool_)
        paint_area(land, [ring])
        assert (water_beside([ring], land.shape) == ~land).all()
