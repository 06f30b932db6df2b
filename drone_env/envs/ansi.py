"""An episode as text, for terminals and for language models."""

from collections.abc import Sequence

from drone_env.core.cells import SYMBOLS, Cell
from drone_env.core.episode import Episode

ROAD = SYMBOLS[Cell.ROAD]
TARGET = "🎯"
WAY = "• "


def draw_text(episode: Episode) -> str:
    """The episode as lines of text: the grid, how the flight stands, and what happened last.

    Args:
        episode: A started episode; it is left as it is.

    Returns:
        `height` lines of the grid, in which each cell takes two terminal columns, row 0 first; then one line with the
        task, the map's seed, steps, battery (units), deliveries and the score x 100; then the message. The current
        target shows as 🎯, other parcels as their kind. There are no colour codes and no newline at the end.

    Raises:
        EpisodeError: before the first reset.
    """
    task = episode.task
    status = (
        task.id,
        f"map {episode.seed}",
        f"step {episode.steps}/{task.max_steps}",
        f"battery {episode.battery_units}/{task.battery_capacity}",
        f"delivered {episode.deliveries_done}/{task.deliveries}",
        f"score {100 * episode.score:.1f}/100",
    )
    rows = _symbols(episode)
    if episode.target is not None:
        x, y = episode.target
        rows[y][x] = TARGET
    return "\n".join([*("".join(row) for row in rows), " · ".join(status), episode.message])


def draw_tour(episode: Episode, path: Sequence[tuple[int, int]], stops: Sequence[tuple[int, int]]) -> str:
    """The same grid with a flight drawn over it.

    Args:
        episode: A started episode; it is left as it is.
        path: (x, y) of the cells that the flight passes: roads show as a dot.
        stops: (x, y) of the parcels in the order of their delivery: they show as their number, from 1.

    Raises:
        EpisodeError: before the first reset.
    """
    rows = _symbols(episode)
    for x, y in path:
        if rows[y][x] == ROAD:
            rows[y][x] = WAY
    for number, (x, y) in enumerate(stops, start=1):
        rows[y][x] = f"{number:<2}"
    return "\n".join("".join(row) for row in rows)


def _symbols(episode: Episode) -> list[list[str]]:
    return [[SYMBOLS[kind] for kind in row] for row in episode.grid().tolist()]
