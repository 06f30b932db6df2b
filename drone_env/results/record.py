"""Records: a flight as JSON, and many flights as JSONL.

The dynamics are deterministic, so task, seed and actions determine a flight. A record also contains what came out, so
that a replay can check it, and a digest of the terrain if the task has its own.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, WithJsonSchema, model_validator
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile
from drone_env.core.tasks import MAX_UNITS, TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.files import read_file, read_lines, write_text
from drone_env.models import DIRECTIONS, Count, Direction, Message, Score

LONGEST_RECORD = 4 << 20
"""Bytes of a record. The longest flight, of 32,000 steps, takes about 1.3 MB."""
AgentLabel = Annotated[
    str,
    Field(
        min_length=1, max_length=200, pattern=r"^[^\p{C}\p{Zl}\p{Zp}]+$", description="Who flew: one printable line."
    ),
    # The pattern has classes that most readers of JSON Schema do not know.
    WithJsonSchema({"type": "string", "minLength": 1, "maxLength": 200}),
]


class EpisodeRecord(Message):
    """One flight, from its reset on. `replay` flies it again."""

    format: Literal["drone_env/episode"] = "drone_env/episode"
    format_version: Literal[1] = 1
    task: str = Field(max_length=100, description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    terrain: str | None = Field(
        default=None, pattern=r"^[0-9a-f]{16}$", description="Digest of the city that was flown; null for other tasks."
    )
    seed: Count = Field(description="Number of the map.")
    agent: AgentLabel
    reward_profile: str = Field(max_length=100, description="What the steps paid.")
    actions: list[Direction] = Field(max_length=MAX_UNITS, fail_fast=True, description="The actions, in order.")
    rewards: list[float] = Field(max_length=MAX_UNITS, fail_fast=True, description="What each action paid, exactly.")
    deliveries: Count = Field(description="Parcels delivered.")
    success: bool = Field(description="Whether all parcels were delivered.")
    score: Score = Field(description="The graded score; provisional if the flight has not ended.")
    ended: bool = Field(description="Whether the flight was flown to its end.")

    @model_validator(mode="after")
    def _rewards_fit(self) -> Self:
        if len(self.rewards) != len(self.actions):
            raise ValueError(f"{len(self.rewards)} rewards do not fit {len(self.actions)} actions")
        return self

    def to_json(self, indent: int | None = None) -> str:
        """The record as JSON; without an indent, on one line."""
        return self.model_dump_json(indent=indent, exclude_none=True)


def record_of(episode: Episode, agent: str) -> EpisodeRecord:
    """The record of an episode as it stands.

    Raises:
        EpisodeError: before the first reset.
    """
    return EpisodeRecord(
        task=episode.task.id,
        task_version=episode.task.version,
        terrain=terrain_digest(episode.task),
        seed=episode.seed,
        agent=agent,
        reward_profile=episode.reward_profile.id,
        actions=[DIRECTIONS[action] for action in episode.actions],
        rewards=episode.rewards,
        deliveries=episode.deliveries_done,
        success=episode.success,
        score=episode.score,
        ended=episode.ended,
    )


def terrain_digest(task: TaskConfig) -> str | None:
    """What tells the terrain of a task from any other, 16 hex digits; None where the seed draws it."""
    return None if task.terrain is None else task.terrain.digest()[:16]


def replay(record: EpisodeRecord, reward_profile: str | RewardProfile | None = None) -> Episode:
    """Fly a record again, and hold the result against what it says, every reward and the score to the last bit.

    Args:
        record: The record.
        reward_profile: What the steps are to pay; None for the profile that the record names. With another profile the
            rewards are not compared.

    Raises:
        UnknownNameError: if there is no such task, version or reward profile.
        InvalidValueError: if the seed is not in [0, 2^53), the city of this name is another one than was flown, there
            are actions after the end, or the flight comes to something else than the record says.
    """
    *_, episode = replay_steps(record, reward_profile)
    return episode


def replay_steps(record: EpisodeRecord, reward_profile: str | RewardProfile | None = None) -> Iterator[Episode]:
    """The same episode at its reset and after each of its actions; it is held against the record after the last.

    Raises:
        UnknownNameError: as `replay`.
        InvalidValueError: as `replay`; what was given out before belongs to a record that is wrong.
    """
    task = get_task(record.task, record.task_version)
    now = terrain_digest(task)
    if record.terrain != now:
        raise InvalidValueError(
            f"the record is of another city than {record.task!r} is now (terrain {record.terrain}, now {now}): fly it "
            "with the file as it was; a city that is changed takes another name"
        )
    episode = Episode(task, record.reward_profile if reward_profile is None else reward_profile, record.seed)
    yield episode
    yield from fly_directions(episode, record.actions)
    came_to = record_of(episode, record.agent)
    wrong = [
        f"{name} {getattr(record, name)!r} where the flight gives {getattr(came_to, name)!r}"
        for name in ("task", "task_version", "seed", "deliveries", "success", "score", "ended")
        if getattr(record, name) != getattr(came_to, name)
    ]
    if record.reward_profile == came_to.reward_profile:
        wrong += _wrong_rewards(record.rewards, came_to.rewards)
    if wrong:
        raise InvalidValueError(f"the record does not fit its flight: {'; '.join(wrong)}")


def fly_directions(episode: Episode, actions: Sequence[Direction]) -> Iterator[Episode]:
    """Fly actions by their names; the episode after each of them.

    Raises:
        InvalidValueError: if there are some after the end.
    """
    for number, action in enumerate(actions):
        if episode.ended:
            raise InvalidValueError(f"the flight ends after {number} steps, but there are {len(actions)} actions")
        episode.step(Action[action])
        yield episode


def _wrong_rewards(says: Sequence[float], pays: Sequence[float]) -> list[str]:
    # Compared by their digits, since 0.0 == -0.0.
    steps = [number for number, (a, b) in enumerate(zip(says, pays, strict=True), 1) if a.hex() != b.hex()]
    if not steps:
        return []
    first = steps[0]
    more = f" (and {len(steps) - 1} more)" if len(steps) > 1 else ""
    return [f"reward {says[first - 1]!r} of step {first} where the flight pays {pays[first - 1]!r}{more}"]


def save_record(record: EpisodeRecord, path: str | Path) -> None:
    """Write a record as JSON, on one line where the file is named `.jsonl`; the file is there whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    path = Path(path)
    write_text(path, record.to_json(None if path.suffix == ".jsonl" else 2) + "\n")


def load_record(path: str | Path) -> EpisodeRecord:
    """Read a record.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a record; the message says what is wrong with it.
    """
    return parse_record(read_file(path, LONGEST_RECORD), str(path))


def parse_record(text: str | bytes, name: str) -> EpisodeRecord:
    """The record that is written as this JSON.

    Args:
        text: The JSON.
        name: What the error calls it.

    Raises:
        InvalidValueError: if it is not a record; the message says what is wrong with it.
    """
    return EpisodeRecord.read(text, f"{name} is not the record of a flight")


class RecordWriter:
    """Appends records to a JSONL file, making it where it is missing. To be used in a `with`, or closed.

    A record is in the file when `write` returns; a process that dies while it writes leaves at most a cut last line.

    Raises:
        OSError: if the file cannot be opened.
        InvalidValueError: if its last line is cut or no record; the file is left as it was.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._file = self._path.open("ab+", buffering=0)
        try:
            self._check_last_line()
        except BaseException:
            self._file.close()
            raise

    def write(self, record: EpisodeRecord) -> None:
        """Append one record.

        Raises:
            OSError: if it cannot be written; a part of the line may be in the file then.
        """
        line = f"{record.to_json()}\n".encode()
        written = self._file.write(line)
        if written != len(line):
            raise OSError(f"only {written} of {len(line)} bytes could be written to {self._path}")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _check_last_line(self) -> None:
        if not self._path.is_file():
            return  # a pipe or a device, which holds no lines
        last = b"".join(deque(read_lines(self._path, LONGEST_RECORD), 1))
        name = f"the last line of {self._path}"
        if last.endswith(b"\n"):
            parse_record(last, name)
        elif last:
            try:
                parse_record(last, name)
            except InvalidValueError:
                raise InvalidValueError(f"{name} is cut; remove it before more are appended") from None
            self._file.write(b"\n")


def read_records(path: str | Path) -> Iterator[EpisodeRecord]:
    """The records of a JSONL file, one line each.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: at the first line that is not a record, with its number; the records before it have been
            given out by then. A last line that is cut is said to be so.
    """
    for number, line in enumerate(read_lines(path, LONGEST_RECORD), 1):
        name = f"line {number} of {path}"
        try:
            yield parse_record(line, name)
        except InvalidValueError as error:
            if line.endswith(b"\n"):
                raise
            raise InvalidValueError(f"the last line is cut, and all before it are whole: {error}") from None
