"""The file of a city: read, written, refused."""

from pathlib import Path

import numpy as np
import pytest

from drone_env.city.city_file import city_text, read_city, write_city
from drone_env.core.cells import Cell
from drone_env.core.terrain import pieces
from drone_env.errors import InvalidTaskError

WHOLE = """format = 1
attribution = "© a \\"town\\", ODbL-1.0"
cell = 16.5
bbox = [24.9351762, 60.164155, 24.9534145, 60.179113]
start = [1, 0]
parcels = [[2, 1], [3, 0]]
names = [
    ["Käpylä", 2.5, 1.0],
    ["a \\"street\\"", 0.0, 2.0, -35],
]

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
    assert city.attribution == '© a "town", ODbL-1.0'
    assert city.names == (("Käpylä", 2.5, 1.0, None), ('a "street"', 0.0, 2.0, -35))
    write_city(city, tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == WHOLE.encode()


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    text = 'format = 1\n\n[terrain]\nrows = [\n    "· · ",\n    "· · ",\n]\n'
    city = read_city(saved(tmp_path, text))
    assert (city.cell, city.bbox, city.start, city.parcels, city.attribution) == (None, None, None, (), "")
    assert city_text(city) == text


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


ALL = f"format = 1\n{ROWS}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "format: Field required; terrain: Field required"),
        ('format = 1\n[terrain]\nrows = ["· · ", "· x"]', "unknown symbol 'x' in row 1; allowed: '· ' road"),
        ('format = 1\n[terrain]\nrows = ["· · ", "· "]', "row 0 has 2 cells, row 1 has 1"),
        (f'format = 1\n[terrain]\nrows = ["{"🏢" * 513}", "{"🏢" * 513}"]', "wide and high, got 513 x 2"),
        (f"name = 1\n{ALL}", "name: Extra inputs are not permitted"),
        (f'attribution = "{"x" * 201}"\n{ALL}', "attribution must be one printable line of at most 200 characters"),
        (f"bbox = [3, 2, 1, 4]\n{ALL}", "-180 <= west < east <= 180"),
        (f"start = [3, 0]\n{ALL}", "the start [3, 0] is outside the 3 x 3 cells"),
        (f"start = [0, 0]\nparcels = [[0, 0]]\n{ALL}", "start and parcels must be on distinct cells"),
        (f"parcels = [[2, 0], [2, 2]]\n{ALL}", "obstacles block every way from parcel 1 to parcel 2 [2, 2]"),
        (f'names = [["a", 1]]\n{ALL}', "names.0.2: Field required"),
        (f"names = {[['a', 1, 2]] * 101}\n{ALL}", "at most 100 names, got 101"),
        (f"format = 1\n[task]\nwide = 1\n{ROWS}", "task.wide: Input should be 'width', 'height'"),
    ],
)
def test_what_is_no_city_is_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidTaskError) as raised:
        read_city(saved(tmp_path, text))
    assert str(raised.value).startswith(f"city {tmp_path / 'city.toml'}: ")
    assert said in str(raised.value)
