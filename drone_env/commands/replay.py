"""`drone-env replay`: recorded flights once more."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.commands.arguments import ChosenProfile
from drone_env.commands.flights import film, log_flight, prepare_film
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.errors import InvalidValueError, StoreError, UnknownNameError

if TYPE_CHECKING:
    from drone_env.results.record import EpisodeRecord

Source = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|ID")]


def replay(
    source: Source,
    verify: bool = False,
    render: bool = False,
    video: Path | None = None,
    reward: ChosenProfile = None,
) -> int:
    """Fly recorded flights again, check that they come to what the records say, and print their log lines.

    Every reward and the score must be the recorded ones to the last bit. Standard output holds the lines that `fly`
    printed, and nothing else; maps and the comparison with the optimum go to standard error. Of a record that does not
    fit its flight nothing is printed but what is wrong with it.

    Example: drone-env replay flight.json --render

    Args:
        source: A record, as `fly --record` saves it; a JSONL file (.jsonl) with one record a line; or the id of an
            episode in the store, whose folder is `DRONE_ENV_DATA`, without that `data`.
        verify: Check all flights and print one line for each, no log. Exits with 1 if one does not fit its record,
            or is of a task, a version or a profile that there is not.
        render: Show the map after every step; with --verify there is no log to show it beside.
        video: Save the flight, which must be the only one, as a film to this .gif file.
        reward: What the steps are to pay, instead of the profile that the record names: another profile, or a TOML
            file with one. The rewards of another profile than the record's are not compared.
    """
    # Loads Pydantic, which only records need.
    from drone_env.results import record as records

    profile = None if reward is None else get_reward_profile(reward)
    prepare_film(video)
    found, failed = _records(source), False
    if video is not None:
        found = list(found)
        if len(found) != 1:
            raise InvalidValueError(f"--video takes one flight, and {source} holds {len(found)}")
    for name, record in found:
        if verify and profile is not None and profile.id != record.reward_profile:
            raise InvalidValueError(
                f"--verify compares the rewards of {record.reward_profile!r}, so --reward cannot be {profile.id!r}"
            )
        try:
            checked = records.replay(record, profile)
        except (InvalidValueError, UnknownNameError) as error:
            if not verify:
                raise InvalidValueError(f"{name}: {error}") from None
            what = "wrong" if isinstance(error, InvalidValueError) else "unknown"
            print(f"{what}: {name}: {error}", flush=True)
            failed = True
            continue
        film(checked, video)
        if not verify:
            episode = Episode(checked.task, checked.reward_profile, record.seed)
            log_flight(episode, record.agent, checked.actions, render)
            continue
        rewards, ended = f"{len(record.rewards)} rewards", "" if record.ended else ", unfinished"
        print(f"verified: {name}: {record.task} map {record.seed}, {rewards}, score {record.score!r}{ended}")
    return int(failed)


def _records(source: str) -> Iterator[tuple[str, "EpisodeRecord"]]:
    """Each record with what to call it."""
    from drone_env.files import data_folder
    from drone_env.results.record import load_record, read_records
    from drone_env.results.sessions import EPISODE_ID
    from drone_env.results.store import FILE_NAME, Store

    path = Path(source)
    if EPISODE_ID.fullmatch(source) and not path.exists():
        folder = data_folder()
        if not (folder / FILE_NAME).is_file():
            raise StoreError(f"there is neither a file {source} nor a store in {folder}: set DRONE_ENV_DATA")
        with Store(folder) as store:
            yield f"episode {source}", store.episode(source).record
    elif path.suffix == ".jsonl":
        for number, record in enumerate(read_records(path), 1):
            yield f"line {number} of {path}", record
    else:
        yield str(path), load_record(path)
