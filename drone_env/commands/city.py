"""`drone-env city`: real places as terrain."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from drone_env.city.city_file import write_city
from drone_env.city.openstreetmap import import_city
from drone_env.commands.flights import prepare_file
from drone_env.core.cells import Cell
from drone_env.errors import InvalidValueError
from drone_env.results.tables import Table, percent, print_table

Source = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Box = Annotated[
    tuple[float, float, float, float] | None, tyro.conf.arg(metavar="WEST SOUTH EAST NORTH", help_behavior_hint="")
]
Size = Annotated[tuple[int, int], tyro.conf.arg(metavar="COLUMNS ROWS")]


def city(file: Source, out: Path, bbox: Box = None, cell: float = 16.0, size: Size = (64, 64)) -> None:
    """Convert an extract of OpenStreetMap to a city: buildings, trees, water, rails and pads on a grid.

    A city is a text file that you can read and edit. If an error occurs, nothing is written. The same input gives the
    same bytes. Needs the extra `city`.

    Example: drone-env city helsinki.osm.pbf --out helsinki.toml

    Args:
        file: The extract: XML (.osm, .osm.gz, .osm.bz2) or PBF, at most 128 MiB.
        out: The TOML file to write; it must not exist.
        bbox: The area in degrees. Without it, the middle of the file.
        cell: Metres along the side of a cell, 1 to 100.
        size: Maximum number of columns and rows, 2 to 512 each.
    """
    if out.suffix != ".toml":
        raise InvalidValueError(f"--out takes a file that ends in .toml, got {out}")
    if out.exists():
        raise InvalidValueError(f"{out} exists: remove it, or name another file")
    imported = import_city(file, bbox, cell, size)
    prepare_file("--out", out)
    write_city(imported, out)
    height, width = imported.grid.shape
    print(f"{out}: {width} x {height} cells of {cell:g} metres")
    print(f"--bbox {' '.join(f'{side:.7f}' for side in imported.bbox or ())}")
    counts = np.bincount(imported.grid.ravel()).tolist()
    kinds = [(Cell(kind).name.lower(), f"{n}", percent(n / (width * height))) for kind, n in enumerate(counts) if n]
    print_table(Table("", ("cell", "cells", "share"), kinds), names=1)
    print(imported.attribution)
