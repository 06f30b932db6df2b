"""Kinds of cells. The ids are frozen, because networks and replays depend on them."""

from enum import IntEnum
from typing import NamedTuple


class Cell(IntEnum):
    """Cell ids of grids. New kinds come last."""

    ROAD = 0
    BUILDING = 1
    TREE = 2
    OBSTACLE = 3
    DELIVERY = 4
    DELIVERED = 5
    DRONE = 6
    UNKNOWN = 7
    PAD = 8


class CellKind(NamedTuple):
    """Name, emoji and effect of a kind of cell."""

    name: str
    emoji: str
    effect: str


CELL_KINDS: dict[Cell, CellKind] = {
    Cell.ROAD: CellKind("road", "🛣", "free flight"),
    Cell.BUILDING: CellKind("building", "🏢", "extra battery or no way through in some tasks, else as road"),
    Cell.TREE: CellKind("tree", "🌳", "extra battery or no way through in some tasks, else as road"),
    Cell.OBSTACLE: CellKind("obstacle", "🚧", "extra battery or no way through in some tasks, else as road"),
    Cell.DELIVERY: CellKind("delivery", "📦", "fly here to deliver the parcel"),
    Cell.DELIVERED: CellKind("delivered", "✅", "this parcel has been delivered"),
    Cell.DRONE: CellKind("drone", "🚁", "where the drone is; hides the cell below"),
    Cell.UNKNOWN: CellKind("unknown", "❔", "never on a map; padding for networks"),
    Cell.PAD: CellKind("pad", "🔋", "waiting here charges the battery"),
}
N_CELL_KINDS = len(CELL_KINDS)
SYMBOLS = {int(cell): "· " if cell == Cell.ROAD else kind.emoji for cell, kind in CELL_KINDS.items()}
"""The symbol of each cell id in text, two terminal columns wide. Roads are frequent, so their symbol is a dot."""
TARGET = "🎯"
"""The symbol of the current target in text."""
LETTERS = dict(zip((kind.name for kind in CELL_KINDS.values()), ".BTOPxD?C", strict=True))
"""The letter of each kind of cell, for language models and for terminals without emoji."""
ROAD_CELL, DELIVERY_CELL, PAD_CELL = int(Cell.ROAD), int(Cell.DELIVERY), int(Cell.PAD)
DELIVERED_CELL, DRONE_CELL = int(Cell.DELIVERED), int(Cell.DRONE)
