"""Extracts of OpenStreetMap become cities."""

from pathlib import Path

import numpy as np
import pytest

from drone_env.city.city_file import city_text, text_rows
from drone_env.city.openstreetmap import import_city
from drone_env.city.raster import metres_per_degree, paint_area, water_beside
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
            Drawing().way((0, 0.5), (2.1, 0.5), (3.9, 0.5), (6, 0.5), barrier="wall", missing=[2]),
            ["##....", "......", "......", "......"],
            id="a wall that leaves the extract",
        ),
        pytest.param(
            Drawing().way((3, -1), (3, 5), natural="coastline"), ["###..."] * 4, id="a coast: south, so west is water"
        ),
        pytest.param(
            Drawing().way(*RING[::-1], natural="coastline"),
            ["######", "#....#", "#....#", "######"],
            id="an island",
        ),
        pytest.param(Drawing().way(*RING, natural="coastline"), [*OPEN[:1], ".####.", ".####.", "......"], id="a bay"),
    ],
)
def test_a_thing_becomes_these_cells(drawing: Drawing, rows: list[str], tmp_path: Path) -> None:
    assert rows_of(drawing, tmp_path) == rows


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
