"""The file of a city: read, written, refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drone_env.city.city_file import City, city_text, read_city, write_city
from drone_env.core.cells import SYMBOLS, Cell
from drone_env.core.episode import Episode
from drone_env.core.terrain import pieces
from drone_env.envs.ansi import draw_text
from drone_env.errors import InvalidTaskError

WHOLE = """format = 1
attribution = "© OpenStreetMap contributors"
licence = "ODbL-1.0"
source = "a \\"town\\".osm"
cell = 16.5
bbox = [24.9351762, 60.164155, 24.9534145, 60.179113]
start = [1, 0]
parcels = [[2, 1], [3, 0]]

[task]
deliveries = 2
battery_capacity = 30

[terrain]
rows = [
    "🏢· · · ",
    "🌳🚧· 🔋",
]
"""
ROWS = '[terrain]\nrows = ["· · · ", "· 🚧🚧", "· 🚧· "]\n'


def saved(folder: Path, text: str) -> Path:
    path = folder / "city.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_city_is_read_and_written_byte_for_byte(tmp_path: Path) -> None:
    path = saved(tmp_path, WHOLE)
    city = read_city(path)
    assert city.grid.tolist() == [
        [Cell.BUILDING, Cell.ROAD, Cell.ROAD, Cell.ROAD],
        [Cell.TREE, Cell.OBSTACLE, Cell.ROAD, Cell.PAD],
    ]
    assert (city.cell, city.start, city.parcels) == (16.5, (1, 0), ((2, 1), (3, 0)))
    assert city.bbox == (24.9351762, 60.164155, 24.9534145, 60.179113)
    assert city.source == 'a "town".osm'
    write_city(city, tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == WHOLE.encode()


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    text = 'format = 1\n\n[terrain]\nrows = [\n    "· · ",\n    "· · ",\n]\n'
    city = read_city(saved(tmp_path, text))
    assert (city.cell, city.bbox, city.start, city.parcels, city.attribution) == (None, None, None, (), "")
    assert city_text(city) == text


def test_the_symbols_are_those_of_the_map_as_text() -> None:
    episode = Episode("skyline_hard", seed=3)
    drawn = draw_text(episode).splitlines()[: episode.task.height]
    shown = "".join(drawn)
    assert all(SYMBOLS[kind] in shown for kind in (Cell.ROAD, Cell.BUILDING, Cell.TREE, Cell.OBSTACLE, Cell.PAD))


def test_pieces_go_round_obstacles_and_not_across_corners() -> None:
    grid = np.array([[0, 3, 0], [1, 2, 3], [3, 8, 0]], np.uint8)
    (a, _, b), *_ = piece = pieces(grid == Cell.OBSTACLE).tolist()
    assert piece == [[a, 0, b], [a, a, 0], [0, a, a]]
    assert 0 < min(a, b) < max(a, b)
    # Pieces that meet only further down are one, and those of two grids are not.
    comb = np.array([[0, 3, 0], [0, 3, 0], [0, 0, 0]])
    one, other = pieces(np.stack([comb, comb]) == Cell.OBSTACLE)
    assert len(np.unique(one[comb == 0])) == len(np.unique(other[comb == 0])) == 1
    assert one[0, 0] != other[0, 0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "format must be 1, got None"),
        (f"format = 2\n{ROWS}", "format must be 1, got 2"),
        (f"format = true\n{ROWS}", "format must be 1, got True"),
        ("format = 1", "[terrain] holds rows and nothing else, got None"),
        ("format = 1\n[terrain]\nrows = []\nx = 1", "[terrain] holds rows and nothing else, got ['rows', 'x']"),
        ("format = 1\n[terrain]\nrows = []", "rows must be a list of texts"),
        ("format = 1\n[terrain]\nrows = [1]", "rows must be a list of texts"),
        ('format = 1\n[terrain]\nrows = ["· · ", "· x"]', "unknown symbol 'x' in row 1, column 1; allowed: '· ' road"),
        ('format = 1\n[terrain]\nrows = ["· · ", "📦· "]', "unknown symbol '📦·' in row 1, column 0"),
        ('format = 1\n[terrain]\nrows = ["· ·"]', "unknown symbol '·' in row 0, column 1"),
        ('format = 1\n[terrain]\nrows = ["· · ", "· "]', "row 0 has 2 cells, row 1 has 1"),
        ('format = 1\n[terrain]\nrows = ["· ", "· "]', "2 to 512 cells wide and high, got 1 x 2"),
        ('format = 1\n[terrain]\nrows = ["", ""]', "2 to 512 cells wide and high, got 0 x 2"),
        (
            f'format = 1\n[terrain]\nrows = ["{"🏢" * 513}", "{"🏢" * 513}"]',
            "2 to 512 cells wide and high, got 513 x 2",
        ),
        (f"format = 1\nname = 1\n{ROWS}", "unknown key 'name'; allowed: format, attribution"),
        (f"format = 1\nlicence = 1\n{ROWS}", "licence must be a text, got 1"),
        (f'format = 1\nlicence = "\\u0007"\n{ROWS}', "licence must be one printable line of at most 200 characters"),
        (
            f'format = 1\nlicence = "{"x" * 201}"\n{ROWS}',
            "licence must be one printable line of at most 200 characters",
        ),
        (f"format = 1\ncell = true\n{ROWS}", "cell must be a number of metres, got True"),
        (f"format = 1\ncell = 0\n{ROWS}", "cell must be metres above 0, got 0.0"),
        (f"format = 1\ncell = nan\n{ROWS}", "cell must be a number of metres, got nan"),
        (f"format = 1\ncell = 1e400\n{ROWS}", "cell must be a number of metres, got inf"),
        (f"format = 1\nbbox = [1, 2, 3]\n{ROWS}", "bbox must be [west, south, east, north], got [1, 2, 3]"),
        (f"format = 1\nbbox = [3, 2, 1, 4]\n{ROWS}", "-180 <= west < east <= 180"),
        (f"format = 1\nstart = [0, 1.0]\n{ROWS}", "start must be [x, y], two integers, got [0, 1.0]"),
        (f"format = 1\nstart = [3, 0]\n{ROWS}", "start [3, 0] is outside the 3 x 3 cells"),
        (f"format = 1\nstart = [0, -1]\n{ROWS}", "start [0, -1] is outside"),
        (f"format = 1\nstart = [1, 1]\n{ROWS}", "start [1, 1] must be on a road, there is an obstacle"),
        (f"format = 1\nparcels = 1\n{ROWS}", "parcels must be [[x, y], ...], got 1"),
        (f"format = 1\nparcels = [[0, 0], 1]\n{ROWS}", "parcel 1 must be [x, y], two integers, got 1"),
        (f"format = 1\nparcels = [[0, 0], [0, 0]]\n{ROWS}", "parcel 1 is where parcel 0 is, at [0, 0]"),
        (f"format = 1\nstart = [0, 0]\nparcels = [[0, 0]]\n{ROWS}", "parcel 0 is where start is, at [0, 0]"),
        (
            f"format = 1\nstart = [2, 2]\nparcels = [[2, 0]]\n{ROWS}",
            "parcel 0 [2, 0] cannot be reached from start [2, 2]",
        ),
        (f"format = 1\nparcels = [[2, 0], [2, 2]]\n{ROWS}", "parcel 1 [2, 2] cannot be reached from parcel 0 [2, 0]"),
        (f"format = 1\nparcels = {[[0, 0]] * 17}\n{ROWS}", "at most 16 parcels, got 17"),
        (f"format = 1\ntask = 1\n{ROWS}", "[task] must be a table, got 1"),
        (f"format = 1\n[task]\nwide = 1\n{ROWS}", "unknown number 'wide' in [task]; allowed: width, height"),
        (f"format = 1\n[task]\npads = 1.0\n{ROWS}", "pads must be an integer, got 1.0"),
        ("format = ", "not TOML that can be read"),
    ],
)
def test_what_is_no_city_is_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidTaskError) as raised:
        read_city(saved(tmp_path, text))
    assert said in str(raised.value)
    assert str(raised.value).startswith(f"city {tmp_path / 'city.toml'}: ")


def test_the_largest_city_is_read(tmp_path: Path) -> None:
    city = City(np.ones((512, 512), np.uint8), attribution="x" * 200)
    write_city(city, tmp_path / "city.toml")
    assert read_city(tmp_path / "city.toml").grid.shape == (512, 512)


def test_a_city_checks_what_it_is_made_of() -> None:
    city = City(np.zeros((2, 3), np.uint8), start=(2, 1), parcels=((0, 0),))
    with pytest.raises(InvalidTaskError, match="must be on a road, there is a building"):
        replace(city, grid=np.array([[1, 0, 0], [0, 0, 0]], np.uint8))
