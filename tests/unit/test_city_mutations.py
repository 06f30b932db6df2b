"""Mutated extracts, maps and cities."""

import os
import random
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from drone_env.city.city_file import read_city
from drone_env.commands.city import city
from drone_env.errors import DroneEnvError
from tests.unit.osm_files import Drawing, converted

MUTATIONS = int(os.environ.get("DRONE_ENV_MUTATIONS", "100"))
"""Of each file."""
HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"


def mutated(content: bytes, seed: int) -> bytes:
    """A file with some of its bytes changed, moved, doubled, taken away, or cut off."""
    lots, changed = random.Random(seed), bytearray(content)
    how = lots.randrange(6)
    if how == 0:
        return content[: lots.randrange(len(content))]
    for _ in range(lots.choice((1, 1, 2, 5, 20))):
        at, to = lots.randrange(len(changed)), lots.randrange(len(changed))
        if how == 1:
            changed[at] = lots.randrange(256)
        elif how == 2:
            changed[at] ^= 1 << lots.randrange(8)
        elif how == 3 and len(changed) > 400:
            del changed[at : at + lots.randrange(1, 200)]
        elif how == 4:
            changed[at:at] = changed[to : to + lots.randrange(1, 200)]
        else:  # a digit for another: what is then read is mostly still in the format
            digits = [i for i in range(at, min(at + 200, len(changed))) if 48 <= changed[i] < 58]
            for i in digits[:1]:
                changed[i] = lots.choice(b"0123456789-.")
    return bytes(changed)


def survive(cases: Iterable[int], source: Path, folder: Path) -> Counter[bool]:
    """Make cities of mutated files, and count how often that went well.

    What the command line does not end in one line for, or leaves behind, fails.
    """
    content, path, out = source.read_bytes(), folder / f"m{''.join(source.suffixes)}", folder / "m.toml"
    went_well: Counter[bool] = Counter()
    for seed in cases:
        path.write_bytes(mutated(content, seed))
        try:
            city(path, out)
        except DroneEnvError as error:
            went_well[False] += str(error).startswith(str(path))
        else:
            read_city(out)
            out.unlink()
            went_well[True] += 1
        assert list(folder.iterdir()) == [path], seed
    return went_well


def few(kind: str, number: int) -> bool:
    return kind == "r" or number % 11 == 0


FILES: dict[str, Callable[[Path], Path]] = {
    "pbf": lambda folder: converted(HELSINKI, folder / "s.osm.pbf", few, "pbf,pbf_compression=none"),
    "xml": lambda folder: (
        Drawing()
        .box(1, 1, 5, 3, building="yes")
        .way((0, 0), (6, 4), railway="rail")
        .way((3, -1), (3, 5), natural="coastline")
        .node((2, 2), natural="tree")
        .box(0, 0, 6, 4)
        .box(2, 1, 4, 3)
        .relation({4: "outer", 5: "inner"}, landuse="forest")
        .save(folder / "s.osm")
    ),
}


@pytest.mark.parametrize("form", FILES)
def test_no_mutation_of_an_extract_hangs_crashes_or_leaves_anything(form: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    went_well = survive(range(MUTATIONS), FILES[form](tmp_path), tmp_path / "out")
    assert went_well.total() == MUTATIONS
    assert went_well[False] > MUTATIONS / 4
    assert went_well[True] > MUTATIONS / 50
