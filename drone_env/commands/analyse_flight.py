"""`drone-env analyse-flight`: the exact regret of each move of a flight."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.commands.arguments import ChosenAgent, ChosenTask, Seed
from drone_env.commands.printing import print_json
from drone_env.core.episode import Episode, rollout
from drone_env.errors import InvalidValueError
from drone_env.results.tables import Table, number, percent, print_table

if TYPE_CHECKING:
    from drone_env.results import analysis

File = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def analyse_flight(
    file: File = None, task: ChosenTask = None, agent: ChosenAgent = None, seed: Seed = None, json: bool = False
) -> None:
    """Print the exact score that each move of a flight lost, and the better moves.

    Name the file of a recorded flight, or a task to fly. Value: the highest attainable score before the move. Regret:
    the loss of value. Better: all moves without regret. A loop is one row. Marks: ?? blunder (a parcel lost),
    ? mistake, ?! inaccuracy, !! the only move that was not a blunder. Accuracy: the share of best moves among those
    on which anything could be lost.

    Example: drone-env analyse-flight --task hard --agent greedy --seed 7

    Example: drone-env analyse-flight flight.json --json

    Args:
        file: A record of `fly --record`.
        task: The task to fly, by short name, id or grader.
        agent: The agent that flies. Default: greedy.
        seed: Number of the map, 0 to 2^53 - 1. Default: a random train map.
        json: Print JSON instead: positions are [x, y].
    """
    # Imported lazily: Pydantic and Numba are slow to load.
    from drone_env.flights.record import load_record
    from drone_env.results import analysis

    if file is not None and (task, agent, seed) == (None, None, None):
        analysed = analysis.analyse_flight(load_record(file))
    elif file is None and task is not None:
        name = "greedy" if agent is None else agent
        start, pilot = Episode(task), make_agent(name, task)
        start.reset(seed)
        flown = start.copy()
        analysed = analysis.analyse_actions(start, rollout(flown, begin(pilot, name, flown)).actions, name)
    else:
        raise InvalidValueError("analyse-flight takes the file of a record alone, or --task, --agent and --seed to fly")
    if json:
        print_json(analysed.to_dict())
    else:
        _print(analysed)


def _print(flight: "analysis.FlightAnalysis") -> None:
    """Print a table of the moves, one of the labels, and the score."""
    from drone_env.results.analysis import MARKS

    loops = {step: loop for loop in flight.loops for step in range(loop.first, loop.last + 1)}
    moves: list[tuple[str, ...]] = []
    for move in flight.moves:
        loop = loops.get(move.step)
        if loop is None:
            moves.append(
                (f"{move.step}", move.action.name, move.mark, f"{move.position}", move.event.name.lower(), *_loss(move))
            )
        elif loop.first == move.step:
            names = ", ".join(action.name for action in loop.actions)
            rounds = (loop.last - loop.first + 1) // len(loop.actions)
            lost = f"{loop.regret:.5f}" if loop.regret else ""
            steps = f"{loop.first} to {loop.last}"
            moves.append((steps, f"{names} x {rounds}", loop.mark, "", loop.words, f"{move.value:.4f}", lost, ""))
    labels = [
        (label, f"{count}", number(math.fsum(m.regret for m in flight.moves if m.label == label), ".5f"), mark)
        for (label, count), mark in zip(flight.counts.items(), MARKS.values(), strict=True)
    ]
    if flight.giving_up is not None:
        mark = MARKS[flight.giving_up.label]
        moves.append(("", "stop", mark, "", "unfinished", *_loss(flight.giving_up)))
        labels.append(("giving up", "", f"{flight.giving_up.regret:.5f}", mark))
    head = ("step", "move", "", "to", "event", "value", "regret", "better")
    print_table(Table(f"{flight.task.id}, map {flight.seed}, flown by {flight.agent}", head, moves), names=8)
    print_table(Table("", ("move", "count", "lost", "mark"), labels), names=1)
    if flight.giving_up is not None:
        print(f"Unfinished after {flight.flown.steps} steps: counted as if it had waited to the end")
    print(f"Score {flight.score:.4f}, optimum {flight.optimum:.4f}, regret {flight.regret:.5f}")
    worst = flight.worst
    if worst is not None:
        steps = f"step {worst.first}" if worst.first == worst.last else f"steps {worst.first} to {worst.last}"
        print(f"Worst: {steps}, regret {worst.regret:.5f}: {flight.worst_why}")
    if flight.why:
        print(flight.why)
    print(f"Accuracy {percent(flight.accuracy)}: {flight.decisive_best} best moves of {flight.decisive} that mattered")


def _loss(lost: "analysis.Move | analysis.GivingUp") -> tuple[str, str, str]:
    """Return value, regret and better moves; empty without regret."""
    if not lost.regret:
        return f"{lost.value:.4f}", "", ""
    return f"{lost.value:.4f}", f"{lost.regret:.5f}", ", ".join(action.name for action in lost.best_actions)
