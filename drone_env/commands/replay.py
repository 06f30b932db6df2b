"""`drone-env replay`: a recorded flight once more."""

from pathlib import Path
from typing import Annotated

import tyro

from drone_env.commands.flights import log_flight
from drone_env.core.actions import Action
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.state_manager import Episode

RewardName = Annotated[str | None, tyro.conf.arg(metavar=f"{'|'.join(REWARD_PROFILES)}|FILE.toml")]
File = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]


def replay(file: File, render: bool = False, reward: RewardName = None) -> None:
    """Fly a recorded flight again, check that it comes to what the record says, and print its log lines.

    Standard output holds the lines that `fly` printed, and nothing else; maps and the comparison with the optimum go to
    standard error. Of a record that does not fit its flight nothing is printed but what is wrong with it.

    Example: drone-env replay flight.json --render

    Args:
        file: The record, as `fly --record` saves it.
        render: Show the map after every step.
        reward: What the steps are to pay, instead of the profile that the record names: another profile, or a TOML
            file with one.
    """
    # Loads Pydantic, which only records need.
    from drone_env.episodes import record as records
    from drone_env.reward_file import reward_profile_from

    record = records.load_record(file)
    checked = records.replay(record, None if reward is None else reward_profile_from(reward))
    episode = Episode(checked.task, checked.reward_profile)
    episode.reset(record.seed)
    log_flight(episode, record.agent, [Action[name] for name in record.actions], render)
