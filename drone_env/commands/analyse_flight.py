"""`drone-env analyse-flight`: the exact regret of each move of a flight."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.commands.arguments import ChosenAgent, ChosenTask, Seed, warn_about_pickles
from drone_env.commands.printing import print_json
from drone_env.core.episode import Episode, rollout
from drone_env.errors import InvalidValueError

File = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def analyse_flight(
    file: File = None, task: ChosenTask = None, agent: ChosenAgent = None, seed: Seed = None, json: bool = False
) -> None:
    """Print the exact score that each move of a flight lost, and the better moves.

    Name the file of a recorded flight, or a task to fly. Value: the highest attainable score before the move. Regret:
    the loss of value. Better: all moves without regret. Marks: ?? blunder (a parcel lost), ? mistake, ?! inaccuracy,
    !! the only move that was not a blunder. Accuracy: the share of best moves among those on which anything could be
    lost.

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
    from drone_env.results import analysis
    from drone_env.results.record import load_record

    if file is not None and (task, agent, seed) == (None, None, None):
        analysed = analysis.analyse_flight(load_record(file))
    elif file is None and task is not None:
        name = "greedy" if agent is None else agent
        warn_about_pickles([name])
        start, pilot = Episode(task), make_agent(name, task)
        start.reset(seed)
        flown = start.copy()
        analysed = analysis.analyse_actions(start, rollout(flown, begin(pilot, name, flown)).actions, name)
    else:
        raise InvalidValueError("analyse-flight takes the file of a record alone, or --task, --agent and --seed to fly")
    if json:
        print_json(analysed.to_dict())
    else:
        print(analysed.to_text())
