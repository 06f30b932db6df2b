"""The centre of Helsinki: from the extract to the file, and what is wrong with an extract."""

import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.city.city_file import read_city
from drone_env.city.importer import import_city
from drone_env.cli import main
from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError
from tests.unit.osm_files import Drawing, converted

HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"
XY = tuple[float, float]


def inside(at: XY, sides: Iterable[tuple[XY, XY]]) -> bool:
    """Whether a ray from a point crosses the sides of an area an odd number of times."""
    x, y = at
    crossings = 0
    for (x0, y0), (x1, y1) in sides:
        if (y0 > y) != (y1 > y):
            crossings += x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    return crossings % 2 == 1


class Read(NamedTuple):
    """The city of the extract, and the XML of the same extract, read by ElementTree; places are (x, y) in cells."""

    grid: npt.NDArray[np.uint8]
    nodes: dict[str, XY]
    ways: dict[str, list[str]]
    tags: list[tuple[ElementTree.Element, dict[str, str]]]

    def cell(self, node: str) -> tuple[int, int]:
        x, y = self.nodes[node]
        return math.floor(x), math.floor(y)

    def holds(self, at: tuple[int, int]) -> bool:
        return 0 <= at[0] < self.grid.shape[1] and 0 <= at[1] < self.grid.shape[0]


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Read:
    folder = tmp_path_factory.mktemp("helsinki")
    city = read_city(made(HELSINKI, folder / "helsinki.toml"))
    assert city.bbox is not None
    west, south, east, north = city.bbox
    height, width = city.grid.shape
    root = ElementTree.parse(converted(HELSINKI, folder / "helsinki.osm")).getroot()
    nodes: dict[str, XY] = {}
    for node in root.iter("node"):
        lon, lat = float(node.attrib["lon"]), float(node.attrib["lat"])
        nodes[node.attrib["id"]] = (lon - west) / (east - west) * width, (north - lat) / (north - south) * height
    ways = {way.attrib["id"]: [nd.attrib["ref"] for nd in way.iter("nd")] for way in root.iter("way")}
    tags = [(thing, {tag.attrib["k"]: tag.attrib["v"] for tag in thing.iter("tag")}) for thing in root]
    return Read(city.grid, nodes, ways, tags)


def buildings(read: Read) -> Iterator[list[tuple[XY, XY]]]:
    """The sides of each building, whether they are a ring's or several rings'."""
    for thing, tags in read.tags:
        if tags.get("building", "no") in ("no", "roof") or tags.get("location") == "underground":
            continue
        refs: list[str] = []
        if thing.tag == "way":
            refs = [thing.attrib["id"]]
        elif thing.tag == "relation" and tags.get("type") == "multipolygon":
            refs = [member.attrib["ref"] for member in thing.iter("member") if member.attrib["type"] == "way"]
        ways = [read.ways.get(ref, ["missing"]) for ref in refs]
        ends = Counter(ref for way in ways for ref in (way[0], way[-1]))
        if all(ref in read.nodes for way in ways for ref in way) and all(n % 2 == 0 for n in ends.values()):
            yield [(read.nodes[a], read.nodes[b]) for way in ways for a, b in pairwise(way)]


def test_the_buildings_agree_with_the_file(read: Read) -> None:
    """By casting a ray from each of 100 points of a cell."""
    height, width = read.grid.shape
    covered = np.zeros((height, width, 100), bool)
    for sides in filter(None, buildings(read)):
        xs, ys = ([corner[i] for side in sides for corner in side] for i in (0, 1))
        for y in range(max(0, math.floor(min(ys))), min(height, math.ceil(max(ys)))):
            for x in range(max(0, math.floor(min(xs))), min(width, math.ceil(max(xs)))):
                for i in np.flatnonzero(~covered[y, x]).tolist():
                    at = x + (i % 10 + 0.5) / 10, y + (i // 10 + 0.5) / 10
                    covered[y, x, i] = inside(at, sides)
    share = covered.mean(axis=2)
    is_building = read.grid == Cell.BUILDING
    assert is_building.sum() > 1000
    assert (is_building | (read.grid == Cell.PAD))[share > 0.55].all()
    assert not is_building[share < 0.45].any()
    # What the two samplings may decide differently is little.
    assert (abs(share - 0.5) <= 0.05).sum() < 0.15 * is_building.sum()


def made(source: Path, out: Path, *more: str) -> Path:
    assert main(["city", str(source), "--out", str(out), *more]) == 0
    return out


def test_the_command_says_what_became_of_the_extract(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    made(HELSINKI, tmp_path / "a.toml", "--picture", str(tmp_path / "a.png"))
    told = capfd.readouterr().out
    assert f"{tmp_path / 'a.toml'}: 63 x 64 cells of 16 metres, the middle of 63 x 104" in told
    assert "charging stations" in told
    assert "that no layer takes (railway=tram" in told
    assert "© OpenStreetMap contributors, ODbL-1.0" in told
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "a.toml"]


def test_the_same_extract_gives_the_same_bytes(tmp_path: Path) -> None:
    again = tmp_path / "again"
    again.mkdir()
    first = made(HELSINKI, tmp_path / "a.toml").read_text(encoding="utf-8")
    assert made(HELSINKI, again / "b.toml").read_text(encoding="utf-8") == first
    assert 'licence = "ODbL-1.0"' in first
    xml = made(converted(HELSINKI, tmp_path / "helsinki.osm"), tmp_path / "x.toml").read_text(encoding="utf-8")
    assert xml.replace('"helsinki.osm"', '"helsinki.osm.pbf"') == first


def test_a_map_needs_no_extra(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "osmium", None)
    (tmp_path / "arena.map").write_text("type octile\nheight 2\nwidth 3\nmap\n.@.\n...\n")
    made(tmp_path / "arena.map", tmp_path / "arena.toml", "--picture", str(tmp_path / "arena.png"))
    told = capfd.readouterr().out
    assert "arena.toml: 3 x 2 cells\n" in told
    assert "It cannot be flown as it is: task 'arena': 6 things do not fit on 5 roads" in told
    (tmp_path / "arena.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n...\n")
    made(tmp_path / "arena.map", tmp_path / "city.toml")
    assert "It cannot be flown as it is: task 'city': city, " in capfd.readouterr().out


WRONG: dict[str, tuple[str, bytes | None, tuple[str, ...], str]] = {
    "absent": ("town.osm", None, (), "No such file"),
    "empty": ("town.osm", b"", (), "town.osm is empty"),
    "another format": ("town.osm", b"PK\x03\x04", (), "not an extract of OpenStreetMap that can be read"),
    "cut short": ("town.osm", Drawing().box(1, 1, 5, 3, building="yes").text()[:-40].encode(), (), "can be read: XML"),
    "nodes missing": (
        "town.osm",
        Drawing().node((0, 0)).box(1, 1, 5, 3, missing=(1,), building="yes").text().encode(),
        (),
        "1 of its areas and ways lack nodes: it is cut short, or not sorted",
    ),
    "a far place": (
        "town.osm.pbf",
        HELSINKI.read_bytes(),
        ("--bbox", "2", "48", "2.01", "48.005"),
        "nothing of the layers",
    ),
    "too many cells": (
        "town.osm.pbf",
        HELSINKI.read_bytes(),
        ("--bbox", "24.93", "60.16", "24.96", "60.18"),
        "--size allows",
    ),
    "a box upside down": ("town.osm.pbf", HELSINKI.read_bytes(), ("--bbox", "25", "61", "26", "60"), "south < north"),
    "a size of nothing": ("town.osm.pbf", b"x", ("--size", "64"), "--size is COLUMNSxROWS"),
    "too large a size": ("town.osm.pbf", b"x", ("--size", "64x513"), "--size must be 2x2 to 512x512, got 64x513"),
    "too small a cell": ("town.osm.pbf", b"x", ("--cell", "0.5"), "--cell must be 1 to 100 metres, got 0.5"),
    "a picture of another kind": ("town.osm.pbf", b"x", ("--picture", "a.jpg"), "a file that ends in .png"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_and_nothing_is_written(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    name, content, more, said = WRONG[case]
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / name).write_bytes(content)
    before = sorted(tmp_path.iterdir())
    more = more if "--picture" in more else (*more, "--picture", "town.png")
    assert main(["city", name, "--out", "town.toml", *more]) == 2
    error = capfd.readouterr().err
    assert said in error
    assert error.startswith("drone-env: ")
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["city", str(HELSINKI), "--out", str(tmp_path / "a.json")]) == 2
    assert main(["city", str(tmp_path), "--out", str(tmp_path / "a.toml")]) == 2
    (tmp_path / "b.toml").mkdir()
    assert main(["city", str(HELSINKI), "--out", str(tmp_path / "b.toml"), "--picture", str(tmp_path / "b.png")]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["b.toml"]
    assert "takes the name of a file, got the folder" in capfd.readouterr().err


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "planet.osm.pbf"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InvalidValueError, match=r"1048576 MiB, at most 128 are read: cut a piece out of it by `osmium"):
        import_city(path)
