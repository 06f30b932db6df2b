"""Mutated extracts of OpenStreetMap."""

import os
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import osmium
import osmium.osm

from drone_env.city.city_file import read_city
from drone_env.commands.city import city
from drone_env.errors import DroneEnvError
from tests.unit.osm_files import converted

MUTATIONS = int(os.environ.get("DRONE_ENV_MUTATIONS", "100"))
"""Of each file."""
HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"


def mutated(content: bytes, seed: int) -> bytes:
    """Change, flip, delete or insert some bytes of a file, or cut it off."""
    random, changed = Random(seed), bytearray(content)
    kind = random.randrange(5)
    if kind == 0:
        return content[: random.randrange(len(content))]
    for _ in range(random.choice((1, 1, 2, 5, 20))):
        at, source = random.randrange(len(changed)), random.randrange(len(changed))
        if kind == 1:
            changed[at] = random.randrange(256)
        elif kind == 2:
            changed[at] ^= 1 << random.randrange(8)
        elif kind == 3:
            del changed[at : at + random.randrange(1, 200)]
        else:
            changed[at:at] = changed[source : source + random.randrange(1, 200)]
    return bytes(changed)


def some(source: Path) -> dict[str, set[int]]:
    """Return ids of some areas and ways, and of all that they consist of."""
    kept: dict[str, set[int]] = {"r": set(), "w": set(), "n": set()}
    areas: Any = osmium.FileProcessor(str(source), osmium.osm.RELATION)
    ways: Any = osmium.FileProcessor(str(source), osmium.osm.WAY)
    for area in areas:
        if area.id % 7 == 0:
            kept["r"].add(area.id)
            kept["w"].update(member.ref for member in area.members)
    for way in ways:
        if way.id % 23 == 0 or way.id in kept["w"]:
            kept["w"].add(way.id)
            kept["n"].update(node.ref for node in way.nodes)
    return kept


def test_no_mutation_of_an_extract_hangs_crashes_or_leaves_anything(tmp_path: Path) -> None:
    kept = some(HELSINKI)
    source = converted(HELSINKI, tmp_path / "s.osm.pbf", lambda kind, number: number in kept[kind])
    content = source.read_bytes()
    folder = tmp_path / "out"
    folder.mkdir()
    path, out = folder / "m.osm.pbf", folder / "m.toml"
    succeeded: Counter[bool] = Counter()
    for seed in range(MUTATIONS):
        path.write_bytes(mutated(content, seed))
        try:
            city(path, out)
        except DroneEnvError as error:
            succeeded[False] += str(error).startswith(str(path))
        else:
            read_city(out)
            out.unlink()
            succeeded[True] += 1
        assert list(folder.iterdir()) == [path], seed
    assert succeeded.total() == MUTATIONS
    assert succeeded[False] > MUTATIONS / 4
    assert succeeded[True] > MUTATIONS / 50
