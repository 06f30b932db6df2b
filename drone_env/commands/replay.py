"""`drone-env replay`: fly recorded flights again."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.commands.arguments import ChosenProfile
from drone_env.commands.flights import log_flight
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.errors import InvalidValueError, UnknownNameError

File = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def replay(file: File, render: bool = False, reward: ChosenProfile = None) -> None:
    """Fly recorded flights again, verify every reward and the score to the last bit, and print their log lines.

    Standard output contains only the lines that `fly` printed; maps and the optimum go to standard error. A record that
    does not fit its flight is an error.

    Example: drone-env replay flight.json --render

    Args:
        file: A record of `fly --record`, or a JSONL file (.jsonl) with one record per line.
        render: Show the map after every step.
        reward: Pay by another profile, or by a TOML file with one. Its rewards are not compared with the record.
    """
    # Loads Pydantic, which only records need.
    from drone_env.flights import record as records

    profile = None if reward is None else get_reward_profile(reward)
    lines = records.read_records(file) if file.suffix == ".jsonl" else [records.load_record(file)]
    for number, record in enumerate(lines, 1):
        name = f"line {number} of {file}" if file.suffix == ".jsonl" else f"{file}"
        try:
            episode = records.replay(record, profile)
        except (InvalidValueError, UnknownNameError) as error:
            raise InvalidValueError(f"{name}: {error}") from None
        start = Episode(episode.task, episode.reward_profile, record.seed)
        log_flight(start, record.agent, episode.actions, render)
