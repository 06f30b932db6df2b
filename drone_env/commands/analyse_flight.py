"""`drone-env analyse-flight`: the exact regret of each move of a flight."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.results.tables import Table, percent, print_table

if TYPE_CHECKING:
    from drone_env.results.analysis import FlightAnalysis

File = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def analyse_flight(file: File) -> None:
    """Print the exact score that each move of a flight lost, and the better moves.

    Value: the highest attainable score before the move. Regret: the loss of value. Better: all moves without regret. A
    loop is one row. Marks: ?? blunder (a parcel lost), ? mistake, ?! inaccuracy, !! the only move that was not a
    blunder. Accuracy: the share of best moves among those on which anything could be lost.

    Example: drone-env analyse-flight flight.json

    Args:
        file: A record of `fly --record`.
    """
    # Imported lazily: Pydantic and Numba are slow to load.
    from drone_env.flights.record import load_record
    from drone_env.results import analysis

    flight = analysis.analyse_flight(load_record(file))
    head = ("step", "move", "", "to", "event", "value", "regret", "better")
    print_table(Table(f"{flight.task.id}, map {flight.seed}, flown by {flight.agent}", head, _rows(flight)), names=8)
    print(f"Moves: {', '.join(f'{count} {label}' for label, count in flight.counts.items())}")
    if not flight.flown.ended:
        print(f"Unfinished after {flight.flown.steps} steps: counted as if it had waited to the end")
    print(f"Score {flight.score:.4f}, optimum {flight.optimum:.4f}, regret {flight.regret:.5f}")
    worst = flight.worst
    if worst is not None:
        steps = f"step {worst.first}" if worst.first == worst.last else f"steps {worst.first} to {worst.last}"
        print(f"Worst: {steps}, regret {worst.regret:.5f}: {flight.worst_why}")
    if flight.why:
        print(flight.why)
    print(f"Accuracy {percent(flight.accuracy)}: {flight.decisive_best} best moves of {flight.decisive} that mattered")


def _rows(flight: "FlightAnalysis") -> list[tuple[str, ...]]:
    """Return a row for each move, and one for each loop."""
    loops = {step: loop for loop in flight.loops for step in range(loop.first, loop.last + 1)}
    rows: list[tuple[str, ...]] = []
    for move in flight.moves:
        loop, value = loops.get(move.step), f"{move.value:.4f}"
        if loop is None:
            lost, better = (f"{move.regret:.5f}", [a.name for a in move.best_actions]) if move.regret else ("", [])
            event = move.event.name.lower()
            where = f"{move.position}"
            rows.append((f"{move.step}", move.action.name, move.mark, where, event, value, lost, ", ".join(better)))
        elif loop.first == move.step:
            moves = ", ".join(action.name for action in loop.actions)
            lost = f"{loop.regret:.5f}" if loop.regret else ""
            rows.append((f"{loop.first} to {loop.last}", moves, loop.mark, "", loop.words, value, lost, ""))
    return rows
