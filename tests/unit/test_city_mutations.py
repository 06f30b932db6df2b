"""Mutated extracts, maps and cities."""

import os
import random
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from drone_env.city.city_file import read_city
from drone_env.commands.city import city
from drone_env.errors import DroneEnvError
from tests.unit.osm_files import converted

MUTATIONS = int(os.environ.get("DRONE_ENV_MUTATIONS", "100"))
"""Of each file."""
HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"


def mutated(content: bytes, seed: int) -> bytes:
    """A file with some of its bytes changed, moved, doubled, taken away, or cut off."""
    lots, changed = random.Random(seed), bytearray(content)
    how = lots.randrange(5)
    if how == 0:
        return content[: lots.randrange(len(content))]
    for _ in range(lots.choice((1, 1, 2, 5, 20))):
        at, to = lots.randrange(len(changed)), lots.randrange(len(changed))
        if how == 1:
            changed[at] = lots.randrange(256)
        elif how == 2:
            changed[at] ^= 1 << lots.randrange(8)
        elif how == 3:
            del changed[at : at + lots.randrange(1, 200)]
        else:
            changed[at:at] = changed[to : to + lots.randrange(1, 200)]
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


def test_no_mutation_of_an_extract_hangs_crashes_or_leaves_anything(tmp_path: Path) -> None:
    source = converted(HELSINKI, tmp_path / "s.osm.pbf", few, "pbf,pbf_compression=none")
    (tmp_path / "out").mkdir()
    went_well = survive(range(MUTATIONS), source, tmp_path / "out")
    assert went_well.total() == MUTATIONS
    assert went_well[False] > MUTATIONS / 4
    assert went_well[True] > MUTATIONS / 50
