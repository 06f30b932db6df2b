"""A picture of which part of the package imports which, drawn from the imports themselves; `tables.py` writes it."""

import ast
from html import escape
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "drone_env"
WIDTH, ROW, BOX_WIDTH, BOX_HEIGHT = 880, 68, 132, 34
STYLE = """
  .back { fill: #fbfaf7 } .box { fill: #ffffff; stroke: #4b5563; rx: 6px }
  .name { font: 600 14px system-ui, sans-serif; fill: #1f2937; text-anchor: middle }
  .edge { fill: none; stroke: #b45309; stroke-opacity: .55; stroke-width: 1.5; marker-end: url(#tip) }
  .tip { fill: #b45309 }
"""


def parts() -> dict[str, set[str]]:
    """Each part of the package (a module or a folder right below it), and the parts that it imports."""
    found: dict[str, set[str]] = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        part = file.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if part == "__init__":
            continue
        imported = found.setdefault(part, set())
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            words = (name.split(".") for name in names)
            imported.update(word[1] for word in words if word[0] == PACKAGE.name and word[1] != part)
    return {part: imported & set(found) for part, imported in found.items()}


def reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    """All that a part imports, itself or by others. No part may reach itself."""
    return graph[start].union(*(reachable(graph, part) for part in graph[start]))


def without_detours(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without each arrow that only shortens a way of several arrows."""
    return {
        part: imported - set().union(*(reachable(graph, other) for other in imported))
        for part, imported in graph.items()
    }


def rows(graph: dict[str, set[str]]) -> list[list[str]]:
    """The parts in rows, each right above the highest row that it imports from; the lowest row first."""
    height: dict[str, int] = {}
    while len(height) < len(graph):
        for part, imported in graph.items():
            if part not in height and imported <= set(height):
                height[part] = 1 + max((height[other] for other in imported), default=-1)
    return [sorted(part for part in graph if height[part] == row) for row in range(1 + max(height.values()))]


def diagram() -> str:
    """The picture as SVG."""
    graph = without_detours(parts())
    floors = rows(graph)
    tall = ROW * len(floors) + 24
    place: dict[str, tuple[float, float]] = {}
    for row, names in enumerate(floors):
        # Each part near the middle of what it stands on.
        names = sorted(names, key=lambda n: (sum(place[o][0] for o in graph[n]) / max(1, len(graph[n])), n))
        # One alone stands beside the middle, so that arrows can pass it.
        aside = (row % 2 - 0.5) * BOX_WIDTH * 1.6 if len(names) == 1 else 0
        for i, name in enumerate(names):
            place[name] = (WIDTH * (i + 0.5) / len(names) + aside, tall - 12 - ROW * (row + 0.5))
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {tall}" role="img">',
        "<title>Which part of drone_env imports which</title>",
        f"<style>{STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path class="tip" d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect class="back" width="{WIDTH}" height="{tall}"/>',
    ]
    for part in sorted(graph):
        for other in sorted(graph[part]):
            (x, y), (to_x, to_y) = place[part], place[other]
            y, to_y = y + BOX_HEIGHT / 2, to_y - BOX_HEIGHT / 2
            bend = (to_y - y) / 2
            lines.append(
                f'<path class="edge" d="M{x:.0f} {y:.0f}C{x:.0f} {y + bend:.0f} {to_x:.0f} {to_y - bend:.0f} '
                f'{to_x:.0f} {to_y:.0f}"/>'
            )
    for part, (x, y) in sorted(place.items()):
        lines.append(
            f'<rect class="box" x="{x - BOX_WIDTH / 2:.0f}" y="{y - BOX_HEIGHT / 2:.0f}" width="{BOX_WIDTH}" '
            f'height="{BOX_HEIGHT}"/><text class="name" x="{x:.0f}" y="{y + 5:.0f}">{escape(part)}</text>'
        )
    return "\n".join([*lines, "</svg>"]) + "\n"
