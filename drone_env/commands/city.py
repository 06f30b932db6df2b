"""`drone-env city`: real places as terrain."""

import re
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from drone_env.city.city_file import MAX_SIDE, task_of, write_city
from drone_env.city.importer import Imported, import_city
from drone_env.commands.flights import prepare_file
from drone_env.core.cells import Cell
from drone_env.core.terrain import pieces
from drone_env.envs.registry import check_names
from drone_env.errors import InvalidTaskError, InvalidValueError
from drone_env.results.tables import Table, percent, print_table

Source = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Box = Annotated[
    tuple[float, float, float, float] | None, tyro.conf.arg(metavar="WEST SOUTH EAST NORTH", help_behavior_hint="")
]
Size = Annotated[str, tyro.conf.arg(metavar="COLUMNSxROWS")]


def city(file: Source, out: Path, bbox: Box = None, cell: float = 16.0, size: Size = "64x64") -> None:
    """Make the terrain of a real place from an extract of OpenStreetMap: buildings, trees, water, rails, pads.

    The city is a text file that people can read and edit; it is there whole or not at all, and the same file gives the
    same bytes. Standard output tells what became of the extract, and what was dropped. Maps of the MovingAI benchmark
    (.map) become cities too. Needs the extra `city`, except for those.

    Example: drone-env city helsinki.osm.pbf --out helsinki.toml

    Args:
        file: The extract, .osm.pbf or .osm (at most 128 MiB), or a .map.
        out: The TOML file to write.
        bbox: What to take, in degrees. Without it, the middle of the file.
        cell: Metres along the side of a cell, 1 to 100.
        size: The most columns and rows, 2x2 to 512x512.
    """
    numbers = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if numbers is None:
        raise InvalidValueError(f"--size is COLUMNSxROWS, such as 64x64, each at most {MAX_SIDE}; got {size!r}")
    if out.suffix != ".toml":
        raise InvalidValueError(f"--out takes a file that ends in .toml, got {out}")
    imported = import_city(file, bbox, cell, (int(numbers[1]), int(numbers[2])))
    prepare_file("--out", out)
    write_city(imported.city, out)
    _print(imported, out)


def _print(imported: Imported, out: Path) -> None:
    city, grid = imported.city, imported.city.grid
    height, width = grid.shape
    metres = "" if city.cell is None else f" of {city.cell:g} metres"
    cut = imported.whole not in (None, (width, height))
    middle = f", the middle of {' x '.join(map(str, imported.whole or ()))}" if cut else ""
    print(f"{out}: {width} x {height} cells{metres}{middle}")
    if city.bbox is not None:
        print(f"--bbox {' '.join(f'{side:.7f}' for side in city.bbox)}")
    counts = np.bincount(grid.ravel()).tolist()
    kinds = [(Cell(kind).name.lower(), f"{n}", percent(n / grid.size)) for kind, n in enumerate(counts) if n]
    print_table(Table("", ("cell", "cells", "share"), kinds), width=80, names=1)
    largest = np.bincount(pieces(grid == Cell.OBSTACLE).ravel())[1:].max(initial=0)
    print(f"The largest piece that can be flown without entering an obstacle has {largest} cells.")
    try:
        check_names(task_of(city, out.stem))
    except InvalidTaskError as error:
        print(f"It cannot be flown as it is: {error}")
    if city.attribution:
        print(f"Dropped: {imported.outside} things outside, {imported.broken} broken.")
        print(f"{city.attribution}, {city.licence}")
