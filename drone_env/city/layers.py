"""What of OpenStreetMap becomes which kind of cell: `layers.toml`, read once."""

import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from drone_env.core.cells import Cell

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TABLE = Path(__file__).with_name("layers.toml")
Rule = tuple[tuple[str, str], ...]
"""(key, value) of the tags that must all hold; the value `*` stands for any but `no`."""


class Layer(NamedTuple):
    """One layer of the table; `layers.toml` says what its parts mean."""

    name: str
    kind: Cell
    share: float
    points: tuple[Rule, ...]
    areas: tuple[Rule, ...]
    lines: tuple[tuple[Rule, float], ...]
    coasts: tuple[Rule, ...]
    unless: tuple[Rule, ...]

    def takes(self, form: str, tags: Mapping[str, str]) -> bool:
        """Whether a thing of this form, `points`, `areas` or `coasts`, belongs here."""
        return any(holds(rule, tags) for rule in getattr(self, form)) and not self._leaves_out(tags)

    def width(self, tags: Mapping[str, str]) -> float | None:
        """The width in metres of a line that belongs here; None for any other."""
        width = next((width for rule, width in self.lines if holds(rule, tags)), None)
        return None if width is None or self._leaves_out(tags) else width

    def _leaves_out(self, tags: Mapping[str, str]) -> bool:
        return any(holds(rule, tags) for rule in self.unless)


def holds(rule: Rule, tags: Mapping[str, str]) -> bool:
    """Whether a thing with these tags is one that a rule describes."""
    return all(tags.get(key, "no") != "no" if value == "*" else tags.get(key) == value for key, value in rule)


@lru_cache(maxsize=1)
def layers() -> tuple[Layer, ...]:
    """The layers of the table, the one that comes first first."""
    return tuple(map(_layer, tomllib.loads(TABLE.read_text(encoding="utf-8"))["layer"]))


def keys() -> list[str]:
    """The keys by which things are described, those that are only left out not among them."""
    rules = [rule for layer in layers() for rule in (*layer.points, *layer.areas, *layer.coasts)]
    rules += [rule for layer in layers() for rule, _ in layer.lines]
    return sorted({rule[0][0] for rule in rules})


def _layer(row: Mapping[str, Any]) -> Layer:
    forms = {form: tuple(map(_rule, row.get(form, ()))) for form in ("points", "areas", "coasts", "unless")}
    lines = tuple((_rule(text), width) for text, width in row.get("lines", {}).items())
    return Layer(row["name"], Cell[row["kind"].upper()], row.get("share", 1.0), lines=lines, **forms)


def _rule(text: str) -> Rule:
    pairs = (pair.split("=") for pair in text.split())
    return tuple((key, value) for key, value in pairs)
