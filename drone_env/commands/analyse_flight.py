"""`drone-env analyse-flight`: a flight move by move, beside the exact value of every state."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.commands.arguments import ChosenAgent, ChosenTask, Seed, say_trusted
from drone_env.commands.printing import print_json
from drone_env.core.episode import Episode, rollout
from drone_env.errors import InvalidValueError

File = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def analyse_flight(
    file: File = None, task: ChosenTask = None, agent: ChosenAgent = None, seed: Seed = None, json: bool = False
) -> None:
    """Print the exact score that each move of a flight lost, and the better moves.

    The flight is a recorded one, or flown first: name a file or a task. Value: the highest score that could still be
    reached before the move. Regret: by how much the move lowered it. Better: all moves that would not have. Marks: ??
    blunder (a parcel lost), ? mistake, ?! inaccuracy, !! the only move that was not a blunder. Accuracy: the share of
    best moves among those on which anything could be lost.

    Example: drone-env analyse-flight --task hard --agent greedy --seed 7

    Example: drone-env analyse-flight flight.json --json

    Args:
        file: The record of the flight, as `fly --record` saves it.
        task: The task of a flight to be flown, by its short name, id or grader.
        agent: Who flies it, greedy if nothing is said.
        seed: Number of its map, 0 to 2^53 - 1. Without one, a train map is drawn at random.
        json: Print JSON instead: positions are [x, y].
    """
    # These load Pydantic and Numba, which nobody should wait for who does not need them.
    from drone_env.results import analysis
    from drone_env.results.record import load_record

    if file is not None and task is None:
        if agent is not None or seed is not None:
            raise InvalidValueError("a record names agent and seed itself: give the file without --agent and --seed")
        analysed = analysis.analyse_flight(load_record(file))
    elif file is None and task is not None:
        name = "greedy" if agent is None else agent
        say_trusted([name])
        start, pilot = Episode(task), make_agent(name, task)
        start.reset(seed)
        flown = start.copy()
        analysed = analysis.analyse_actions(start, rollout(flown, begin(pilot, name, flown)).actions, name)
    else:
        given = "neither" if file is None else "both"
        raise InvalidValueError(
            f"analyse-flight takes the file of a record, or --task (with --agent and --seed) to fly first; got {given}"
        )
    if json:
        print_json(analysed.to_dict())
    else:
        print(analysed.to_text())
