"""Records: a flight as JSON, and many flights as JSONL.

The dynamics are deterministic, so task, seed and actions determine a flight. A record also contains the rewards and the
score, which a replay checks, and a digest of the terrain if the task has its own.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile
from drone_env.core.tasks import MAX_UNITS, TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.files import append_line, read_file, read_lines, write_text
from drone_env.flights.provenance import AgentLabel, Parent, PersonName, Provenance
from drone_env.models import DIRECTIONS, Count, Direction, Score, StrictModel

LONGEST_RECORD = 4 << 20
"""Maximum bytes of a record. The longest flight, 32,000 steps, takes about 1.3 MB."""


class EpisodeRecord(StrictModel):
    """One flight from its reset. `replay` flies it again."""

    format: Literal["drone_env/episode"] = "drone_env/episode"
    format_version: Literal[1] = 1
    task: str = Field(max_length=100, description="Id of the task.")
    task_version: int = Field(ge=1, description="Version of the task.")
    terrain: str | None = Field(
        default=None, pattern=r"^[0-9a-f]{16}$", description="Digest of the city's terrain; null for other tasks."
    )
    seed: Count = Field(description="Number of the map.")
    agent: AgentLabel = Field(description="Who flew, in words: one printable line.")
    pilot: AgentLabel | None = Field(default=None, description="The pilot; without it, the whole `agent` is the pilot.")
    person: PersonName | None = Field(default=None, description="The name that a person chose.")
    values_used: bool | None = Field(default=None, description="Whether a person turned on values in flight.")
    undo_used: bool | None = Field(default=None, description="Whether a person took back steps.")
    parent: Parent | None = Field(default=None, description="The flight that this one continues.")
    reward_profile: str = Field(max_length=100, description="The profile that paid the rewards.")
    actions: list[Direction] = Field(max_length=MAX_UNITS, fail_fast=True, description="The actions, in order.")
    rewards: list[float] = Field(max_length=MAX_UNITS, fail_fast=True, description="The exact reward of each action.")
    deliveries: Count = Field(description="Parcels delivered.")
    success: bool = Field(description="Whether all parcels were delivered.")
    score: Score = Field(description="The graded score; provisional if the flight has not ended.")
    ended: bool = Field(description="Whether the flight has ended.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.rewards) != len(self.actions):
            raise ValueError(f"{len(self.rewards)} rewards do not fit {len(self.actions)} actions")
        if self.provenance.label != self.agent:
            raise ValueError(f"agent is {self.agent!r}, but the other fields say {self.provenance.label!r}")
        return self

    @property
    def provenance(self) -> Provenance:
        """Who flew, as fields."""
        given = {name: getattr(self, name) for name in Provenance.model_fields}
        known = {name: value for name, value in given.items() if value is not None}
        return Provenance.model_validate({"pilot": self.agent, **known})

    def to_json(self, indent: int | None = None) -> str:
        """The record as JSON; without an indent, on one line."""
        return self.model_dump_json(indent=indent, exclude_none=True)


def record_of(episode: Episode, agent: str | Provenance) -> EpisodeRecord:
    """Return the record of an episode in its present state.

    Raises:
        EpisodeError: before the first reset.
        InvalidValueError: if the agent's name is not one printable line.
    """
    provenance = Provenance.of(agent)
    fields: dict[str, Any] = {} if provenance.is_plain else dict(provenance)
    return EpisodeRecord(
        **fields,
        task=episode.task.id,
        task_version=episode.task.version,
        terrain=terrain_digest(episode.task),
        seed=episode.seed,
        agent=provenance.label,
        reward_profile=episode.reward_profile.id,
        actions=[DIRECTIONS[action] for action in episode.actions],
        rewards=episode.rewards,
        deliveries=episode.deliveries_done,
        success=episode.success,
        score=episode.score,
        ended=episode.ended,
    )


def terrain_digest(task: TaskConfig) -> str | None:
    """Return 16 hex digits that identify the terrain of a task; None if the seed generates it."""
    return None if task.terrain is None else task.terrain.digest()[:16]


def replay(record: EpisodeRecord, reward_profile: str | RewardProfile | None = None) -> Episode:
    """Fly a record again and compare every reward and the score to the last bit.

    Args:
        record: The record.
        reward_profile: The profile that pays the rewards; None for the recorded one. Rewards of another profile are
            not compared.

    Raises:
        UnknownNameError: if there is no such task, version or reward profile.
        InvalidValueError: if the seed is not in [0, 2^53), the city has changed, there are actions after the end, or
            the flight differs from the record.
    """
    task = get_task(record.task, record.task_version)
    terrain = terrain_digest(task)
    if record.terrain != terrain:
        raise InvalidValueError(
            f"the record is of another city {record.task!r} (terrain {record.terrain}, now {terrain}): "
            "replay it with the original file, and rename the changed city"
        )
    episode = Episode(task, record.reward_profile if reward_profile is None else reward_profile, record.seed)
    fly_directions(episode, record.actions)
    result = record_of(episode, record.provenance)
    wrong = [
        f"{name} {getattr(record, name)!r} where the flight gives {getattr(result, name)!r}"
        for name in ("task", "task_version", "seed", "deliveries", "success", "score", "ended")
        if getattr(record, name) != getattr(result, name)
    ]
    if record.reward_profile == result.reward_profile:
        wrong += _wrong_rewards(record.rewards, result.rewards)
    if wrong:
        raise InvalidValueError(f"the record does not fit its flight: {'; '.join(wrong)}")
    return episode


def fly_directions(episode: Episode, actions: Sequence[Direction]) -> Episode:
    """Fly actions given by name and return the episode.

    Raises:
        InvalidValueError: if there are actions after the end.
    """
    for number, action in enumerate(actions):
        if episode.ended:
            raise InvalidValueError(f"the flight ends after {number} steps, but there are {len(actions)} actions")
        episode.step(Action[action])
    return episode


def _wrong_rewards(recorded: Sequence[float], paid: Sequence[float]) -> list[str]:
    # Compares digits, since 0.0 == -0.0.
    for step, (a, b) in enumerate(zip(recorded, paid, strict=True), 1):
        if a.hex() != b.hex():
            return [f"reward {a!r} of step {step} where the flight pays {b!r}"]
    return []


def save_record(record: EpisodeRecord, path: str | Path) -> None:
    """Write a record as JSON, or append it to a JSONL file (`.jsonl`), which is created if it is missing.

    A JSON file is never left partial. A process that dies cuts at most the last line of a JSONL file.

    Raises:
        OSError: if it cannot be written.
    """
    path = Path(path)
    if path.suffix != ".jsonl":
        write_text(path, record.to_json(2) + "\n")
        return
    with path.open("ab", buffering=0) as file:
        append_line(file, record.to_json())


def load_record(path: str | Path) -> EpisodeRecord:
    """Read a record.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: if it is not a record; the message names the invalid field.
    """
    if str(path).endswith(".jsonl"):
        raise InvalidValueError(f"{path} has a record per line: name a .json file with one line of it")
    return parse_record(read_file(path, LONGEST_RECORD), str(path))


def parse_record(text: str | bytes, name: str) -> EpisodeRecord:
    """Parse the JSON of a record.

    Args:
        text: The JSON.
        name: The source of the text, for the error message.

    Raises:
        InvalidValueError: if it is not a record; the message names the invalid field.
    """
    return EpisodeRecord.read(text, f"{name} is not the record of a flight")


def read_records(path: str | Path) -> Iterator[EpisodeRecord]:
    """Yield the records of a JSONL file, one per line.

    Raises:
        OSError: if the file cannot be read.
        InvalidValueError: at the first line that is not a record, with its number. A cut last line is such a line.
    """
    for number, line in enumerate(read_lines(path, LONGEST_RECORD), 1):
        yield parse_record(line, f"line {number} of {path}")
