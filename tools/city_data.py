"""Make the terrain of the tasks that are real places: `python tools/city_data.py`."""

import json
from pathlib import Path

from drone_env.city.openstreetmap import import_city
from drone_env.core import terrain
from drone_env.core.terrain import LETTERS, Terrain

EXTRACT = Path(__file__).parents[1] / "examples" / "cities" / "helsinki.osm.pbf"
CENTRE = (24.9351440, 60.1641664, 24.9534467, 60.1733574)
"""A square of 1,024 metres: west, south, east, north in degrees."""
FOLDER = Path(terrain.__file__).with_name("cities")
CELLS = {"helsinki_8": 8.0, "helsinki_16": 16.0}
"""Metres along the side of a cell, by the name of the file."""


def terrain_text(terrain: Terrain) -> str:
    """The text of a file of `cities`."""
    letters = {kind: chr(letter) for letter, kind in LETTERS.items()}
    about = json.dumps([terrain.attribution, terrain.cell, terrain.names], ensure_ascii=False)
    return "\n".join([about, *("".join(map(letters.__getitem__, row)) for row in terrain.grid().tolist()), ""])


def city_data() -> dict[str, str]:
    """The files, by name."""
    return {name: terrain_text(_terrain(cell)) for name, cell in CELLS.items()}


def _terrain(cell: float) -> Terrain:
    city = import_city(EXTRACT, CENTRE, cell, (128, 128))
    return Terrain(city.grid.tobytes(), city.grid.shape[1], None, (), f"Helsinki, {city.attribution}", cell, city.names)


def main() -> None:
    """Write them."""
    for name, text in city_data().items():
        (FOLDER / f"{name}.txt").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
