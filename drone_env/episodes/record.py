"""A flight as a small file: which map, which actions, and what came of it.

The dynamics are deterministic, so task, seed and actions say it all; the results stand beside them to be checked.
"""

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from drone_env.core.actions import Action
from drone_env.core.rewards import RewardProfile
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.files import replacing
from drone_env.models import Count, Direction, Message, Score


class EpisodeRecord(Message):
    """One flight, from its reset on. `replay` flies it again."""

    format: Literal["drone_env/episode"] = "drone_env/episode"
    format_version: Literal[1] = 1
    task: str = Field(description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    seed: Count = Field(description="Number of the map.")
    agent: str = Field(min_length=1, max_length=200, pattern=r"^\P{C}+$", description="Who flew: one printable line.")
    reward_profile: str = Field(description="What the steps paid.")
    actions: list[Direction] = Field(description="The actions, in order.")
    deliveries: Count = Field(description="Parcels delivered.")
    success: bool = Field(description="Whether all parcels were delivered.")
    score: Score = Field(description="The graded score; provisional if the flight has not ended.")
    ended: bool = Field(description="Whether the flight was flown to its end.")


def record_of(episode: Episode, agent: str) -> EpisodeRecord:
    """The record of an episode as it stands.

    Raises:
        EpisodeError: before the first reset.
    """
    return EpisodeRecord(
        task=episode.task.id,
        task_version=episode.task.version,
        seed=episode.seed,
        agent=agent,
        reward_profile=episode.reward_profile.id,
        actions=[Action(action).name for action in episode.actions],
        deliveries=episode.deliveries_done,
        success=episode.success,
        score=episode.score,
        ended=episode.ended,
    )


def replay(record: EpisodeRecord, reward_profile: str | RewardProfile | None = None) -> Episode:
    """Fly a record again, and hold the result against what it says.

    Args:
        record: The record.
        reward_profile: What the steps are to pay; None for the profile that the record names.

    Raises:
        UnknownNameError: if there is no such task, version or reward profile.
        InvalidValueError: if the seed is not in [0, 2^53), there are actions after the end, or the flight comes to
            something else than the record says.
    """
    task = get_task(record.task, record.task_version)
    episode = Episode(task, record.reward_profile if reward_profile is None else reward_profile)
    episode.reset(record.seed)
    for number, action in enumerate(record.actions, 1):
        if episode.ended:
            raise InvalidValueError(
                f"the flight ends after {number - 1} steps, but the record has {len(record.actions)} actions"
            )
        episode.step(Action[action])
    came_to = record_of(episode, record.agent).model_dump(exclude={"reward_profile"})
    says = record.model_dump(exclude={"reward_profile"})
    wrong = [
        f"{name} {says[name]!r} where the flight gives {came_to[name]!r}"
        for name in says
        if says[name] != came_to[name]
    ]
    if wrong:
        raise InvalidValueError(f"the record does not fit its flight: {'; '.join(wrong)}")
    return episode


def save_record(record: EpisodeRecord, path: str | Path) -> None:
    """Write a record as JSON, so that the file is there whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(Path(path)) as temporary:
        temporary.write_text(record.model_dump_json(indent=2) + "\n", encoding="utf-8")


def load_record(path: str | Path) -> EpisodeRecord:
    """Read a record.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a record; the message says what is wrong with it.
    """
    try:
        return EpisodeRecord.model_validate_json(Path(path).read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        where = "".join(f"{part}: " for part in first["loc"])
        raise InvalidValueError(f"{path} is not the record of a flight: {where}{first['msg']}") from None
