"""`drone-env city`: real places as terrain."""

import re
from collections import Counter
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
from drone_env.files import replacing
from drone_env.results.tables import Table, percent, print_table

Source = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Box = Annotated[
    tuple[float, float, float, float] | None, tyro.conf.arg(metavar="WEST SOUTH EAST NORTH", help_behavior_hint="")
]
Size = Annotated[str, tyro.conf.arg(metavar="COLUMNSxROWS")]
SHOWN = 5


def city(
    file: Source, out: Path, bbox: Box = None, cell: float = 16.0, size: Size = "64x64", picture: Path | None = None
) -> None:
    """Make the terrain of a real place from an extract of OpenStreetMap: buildings, trees, water, rails, pads.

    The city is a text file that people can read and edit; it is there whole or not at all, and the same file gives the
    same bytes. Standard output tells what became of the extract, and what was dropped. Maps of the MovingAI benchmark
    (.map) become cities too. Needs the extra `city`, except for those.

    Example: drone-env city helsinki.osm.pbf --out helsinki.toml

    Args:
        file: The extract, .osm.pbf or .osm (at most 128 MiB), or a .map.
        out: The TOML file to write.
        bbox: What to take, in degrees; of a .map, its first column and row and those after the last. Without it, the
            middle of the file.
        cell: Metres along the side of a cell, 1 to 100.
        size: The most columns and rows, 2x2 to 512x512.
        picture: Draw the terrain in this PNG file.
    """
    numbers = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if numbers is None:
        raise InvalidValueError(f"--size is COLUMNSxROWS, such as 64x64, each at most {MAX_SIDE}; got {size!r}")
    if out.suffix != ".toml":
        raise InvalidValueError(f"--out takes a file that ends in .toml, got {out}")
    if picture is not None and picture.suffix != ".png":
        raise InvalidValueError(f"--picture takes a file that ends in .png, got {picture}")
    imported = import_city(file, bbox, cell, (int(numbers[1]), int(numbers[2])))
    drawn = None
    if picture is not None:
        from drone_env.envs.rendering import draw_terrain  # loads Pillow

        drawn = draw_terrain(imported.city.grid, attribution=imported.city.attribution)
        prepare_file("--picture", picture)
    prepare_file("--out", out)
    write_city(imported.city, out)
    if picture is not None and drawn is not None:
        with replacing(picture) as temporary:
            temporary.write_bytes(drawn)
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
    if imported.layers:
        layers = [(name, kind.name.lower(), f"{things}", f"{cells}") for name, kind, things, cells in imported.layers]
        print_table(Table("", ("layer", "cell", "things", "cells"), layers), width=80, names=2)
    counts = np.bincount(grid.ravel()).tolist()
    kinds = [(Cell(kind).name.lower(), f"{n}", percent(n / grid.size)) for kind, n in enumerate(counts) if n]
    print_table(Table("", ("cell", "cells", "share"), kinds), width=80, names=1)
    largest = np.bincount(pieces(grid == Cell.OBSTACLE).ravel())[1:].max(initial=0)
    print(f"The largest piece that can be flown without entering an obstacle has {largest} cells.")
    try:
        check_names(task_of(city, out.stem))
    except InvalidTaskError as error:
        print(f"It cannot be flown as it is: {error}")
    if imported.layers:
        dropped = f"{imported.outside} things outside, {imported.broken} broken"
        print(f"Dropped: {dropped}, {sum(imported.unknown.values())} that no layer takes{_named(imported.unknown)}.")
    if city.attribution:
        print(f"{city.attribution}, {city.licence}")


def _named(unknown: Counter[str]) -> str:
    """The most frequent, for people."""
    often = sorted(unknown.items(), key=lambda pair: (-pair[1], pair[0]))
    words = ", ".join([f"{tag} {n}" for tag, n in often[:SHOWN]] + ["..."] * (len(often) > SHOWN))
    # Whoever draws the extract must not write to the terminal.
    return f" ({''.join(c if c.isprintable() else '?' for c in words)})" if words else ""
