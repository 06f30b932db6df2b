"""Extracts of OpenStreetMap, and maps of the MovingAI benchmark, as cities."""

from pathlib import Path

import numpy as np
import pytest

from drone_env.city.city_file import city_text, text_rows
from drone_env.city.importer import import_city
from drone_env.city.raster import metres_per_degree, paint_area, water_beside
from drone_env.commands.city import city
from drone_env.errors import InvalidValueError
from tests.unit.osm_files import BOX, Drawing

SIGNS = {"· ": ".", "🏢": "B", "🌳": "T", "🚧": "#", "🔋": "P"}
RING = ((1, 1), (5, 1), (5, 3), (1, 3), (1, 1))
OPEN = ["......"] * 4


def rows_of(drawing: Drawing, folder: Path) -> list[str]:
    """The rows of a drawing's city, a letter for each cell."""
    text = "\n".join(text_rows(import_city(drawing.save(folder / "town.osm"), BOX).city.grid))
    for symbol, sign in SIGNS.items():
        text = text.replace(symbol, sign)
    return text.split("\n")


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
            Drawing().node((0.5, 0.5), natural="tree").node((5.9, 3.9), natural="tree").node((6, 2), natural="tree"),
            ["T.....", "......", "......", ".....T"],
            id="trees",
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
            Drawing()
            .box(2, 0, 4, 4, natural="wood")
            .box(2, 0, 4, 2, building="yes")
            .box(2, 2, 6, 3, natural="water")
            .node((5.5, 2.5), natural="tree"),
            ["..BB..", "..BB..", "..####", "..TT.."],
            id="the first layer has a cell",
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


def test_what_is_dropped_is_counted(tmp_path: Path) -> None:
    drawing = (
        Drawing()
        .box(1, 1, 5, 3, building="yes")
        .box(7, 1, 8, 3, building="yes")
        .node((-1, 2), natural="tree")
        .box(1, 1, 5, 3, missing=(1,), building="yes")
        .way((1, 1), (2, 2), missing=(0, 1), railway="rail")
        .node((2, 2), barrier="bollard")
        .way((0, 0), (1, 1), railway="tram")
        .node((2, 2), shop="books")
    )
    imported = import_city(drawing.save(tmp_path / "town.osm"), BOX)
    assert (imported.outside, imported.broken) == (2, 2)
    assert imported.unknown == {"barrier=bollard": 1, "railway=tram": 1}
    of_buildings = next(row for row in imported.layers if row[0] == "buildings")
    assert of_buildings[2:] == (1, 8)


def test_without_a_box_the_middle_of_the_file_is_taken(tmp_path: Path) -> None:
    drawing = Drawing().box(2, 1, 4, 3, building="yes")
    imported = import_city(drawing.save(tmp_path / "town.osm"), size=(4, 2))
    assert imported.whole == (6, 4)
    assert text_rows(imported.city.grid) == ["· 🏢🏢· "] * 2
    again = import_city(tmp_path / "town.osm", imported.city.bbox).city
    assert city_text(again) == city_text(imported.city)
    # A file that does not say what it covers is measured.
    drawing = Drawing(bounds=False).node((0, 0)).node((6, 4)).box(2, 1, 4, 3, building="yes")
    imported = import_city(drawing.save(tmp_path / "town.osm"))
    assert text_rows(imported.city.grid) == ["· · · · · · ", "· · 🏢🏢· · ", "· · 🏢🏢· · ", "· · · · · · "]
    assert imported.city.bbox == pytest.approx(BOX, abs=1e-7)


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


MAP = "type octile\nheight 3\nwidth 4\nmap\n.G@O\nTWS.\n....\n"


def test_a_map_of_the_benchmark(tmp_path: Path) -> None:
    path = tmp_path / "arena.map"
    path.write_text(MAP)
    city = import_city(path).city
    assert text_rows(city.grid) == ["· · 🚧🚧", "🚧🚧🌳· ", "· · · · "]
    assert (city.cell, city.bbox, city.source) == (None, None, "arena.map")
    assert text_rows(import_city(path, (1, 0, 3, 2)).city.grid) == ["· 🚧", "🚧🌳"]
    imported = import_city(path, size=(2, 2))
    assert (text_rows(imported.city.grid), imported.whole) == (["· 🚧", "🚧🌳"], (4, 3))


@pytest.mark.parametrize(
    ("text", "box", "said"),
    [
        ("type tile\n", None, "begins with `type octile`, `height H`, `width W`, `map`, a line each; got 'type tile"),
        (MAP.replace("height 3", "height 4"), None, "height is 4, and there are 3 rows"),
        (MAP.replace("width 4", "width 5"), None, "width is 5, and row 0 has 4 cells"),
        (MAP.replace("S", "x"), None, "unknown sign 'x' in row 1, column 2; allowed: . G S @ O T W"),
        (MAP, (0, 0, 5, 3), "whole and within 4 x 3; got 0 0 5 3"),
    ],
)
def test_what_is_no_map_of_the_benchmark_is_refused(
    text: str, box: tuple[float, float, float, float] | None, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "arena.map"
    path.write_text(text)
    with pytest.raises(InvalidValueError) as raised:
        import_city(path, box)
    assert said in str(raised.value)


def test_tags_of_strangers_do_not_write_to_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawing = Drawing().box(1, 1, 5, 3, building="yes").node((2, 2), barrier="[red]a\u009b2J\u202e")
    city(drawing.save(tmp_path / "town.osm"), tmp_path / "town.toml", bbox=BOX)
    assert "1 that no layer takes (barrier=[red]a?2J? 1)." in capsys.readouterr().out
