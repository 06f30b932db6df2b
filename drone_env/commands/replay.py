"""`drone-env replay`: fly recorded flights again."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.commands.arguments import ChosenProfile
from drone_env.commands.flights import log_flight
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.errors import InvalidValueError, StoreError, UnknownNameError

if TYPE_CHECKING:
    from drone_env.flights.record import EpisodeRecord

Source = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|ID")]


def replay(
    source: Source,
    verify: bool = False,
    render: bool = False,
    reward: ChosenProfile = None,
) -> int:
    """Fly recorded flights again, verify every reward and the score to the last bit, and print their log lines.

    Standard output contains only the lines that `fly` printed; maps and the optimum go to standard error. If a record
    does not fit its flight, only the difference is printed.

    Example: drone-env replay flight.json --render

    Args:
        source: A record of `fly --record`, a JSONL file (.jsonl) with one record per line, or the id of an episode in
            the store (`DRONE_ENV_DATA`, by default `data`).
        verify: Print one line per flight instead of the log. Exits with 1 if a record does not fit its flight, or its
            task, version or profile is unknown.
        render: Show the map after every step; ignored with --verify.
        reward: Pay by another profile, or by a TOML file with one. Its rewards are not compared with the record.
    """
    # Loads Pydantic, which only records need.
    from drone_env.flights import record as records

    profile = None if reward is None else get_reward_profile(reward)
    failed = False
    for name, record in _records(source):
        if verify and profile is not None and profile.id != record.reward_profile:
            raise InvalidValueError(
                f"--verify compares the rewards of {record.reward_profile!r}, so --reward cannot be {profile.id!r}"
            )
        try:
            episode = records.replay(record, profile)
        except (InvalidValueError, UnknownNameError) as error:
            if not verify:
                raise InvalidValueError(f"{name}: {error}") from None
            print(f"{'wrong' if isinstance(error, InvalidValueError) else 'unknown'}: {name}: {error}", flush=True)
            failed = True
            continue
        if verify:
            rewards, ended = f"{len(record.rewards)} rewards", "" if record.ended else ", unfinished"
            print(f"verified: {name}: {record.task} map {record.seed}, {rewards}, score {record.score!r}{ended}")
        else:
            start = Episode(episode.task, episode.reward_profile, record.seed)
            log_flight(start, record.agent, episode.actions, render)
    return int(failed)


def _records(source: str) -> "Iterable[tuple[str, EpisodeRecord]]":
    """Return each record with its name for messages."""
    from drone_env.files import data_folder
    from drone_env.flights.flight import FLIGHT_ID
    from drone_env.flights.record import load_record, read_records
    from drone_env.flights.store import FILE_NAME, Store

    path = Path(source)
    if path.suffix == ".jsonl":
        return ((f"line {number} of {path}", record) for number, record in enumerate(read_records(path), 1))
    if path.exists() or not FLIGHT_ID.fullmatch(source):
        return [(str(path), load_record(path))]
    folder = data_folder()
    if not (folder / FILE_NAME).is_file():
        raise StoreError(f"there is neither a file {source} nor a store in {folder}: set DRONE_ENV_DATA")
    with Store(folder) as store:
        return [(f"episode {source}", store.episode(source).record)]
