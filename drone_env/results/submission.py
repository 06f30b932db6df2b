"""Submissions to the leaderboard: an agent's flights over the first test maps of its tasks, as lines of JSON.

The first line describes the agent, each other line one flight: task by task, map by map. The actions determine a
flight, so anybody can verify its score.
"""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field
from typing_extensions import Self

from drone_env import __version__
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import MAX_UNITS, TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.files import differences, read_lines, write_text
from drone_env.flights.provenance import AgentLabel
from drone_env.flights.record import fly_directions
from drone_env.models import DIRECTIONS, Direction, Score, Seed, StrictModel
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.folder import shipped_results
from drone_env.results.result import Results

LETTERS: dict[str, Direction] = {name[0]: name for name in DIRECTIONS}
"""The name of each action by its letter."""
LONGEST = 1 << 16
"""Maximum bytes of a line; a flight has at most 32,000 actions."""


class SubmissionHead(StrictModel):
    """The first line: who flew, and what."""

    format: Literal["drone_env/submission"] = "drone_env/submission"
    format_version: Literal[1] = 1
    package: str = Field(default=__version__, max_length=40)
    agent: AgentLabel = Field(description="The agent or the language model.")
    link: str = Field(pattern=r"^(https?://|docs/)[!-~]{1,300}$", description="Its code, paper or transcripts.")
    tasks: dict[str, int] = Field(min_length=1, description="The version of each task, in the order of the flights.")
    maps: int = Field(ge=20, le=1000, description="Number of maps of each task, from the first of the test split.")
    prompt: str | None = Field(default=None, max_length=100, description="The prompt of a language model.")
    unusable: float | None = Field(default=None, ge=0, le=1, description="Reported share of unusable answers.")


class SubmittedFlight(StrictModel):
    """A line with a flight."""

    task: str = Field(max_length=100)
    seed: Seed
    actions: str = Field(pattern=f"^[{''.join(LETTERS)}]*$", max_length=MAX_UNITS)
    score: Score = Field(description="The score; if the flight has not ended, that of waiting from here on.")
    checksum: str = Field(description="CRC-32 of the other fields, which shows accidental changes.")

    @classmethod
    def of(cls, episode: Episode) -> Self:
        """Return the line of a flight."""
        actions = "".join([DIRECTIONS[action][0] for action in episode.actions])
        score = episode.counted_score()
        checksum = f"{zlib.crc32(f'{episode.task.id} {episode.seed} {actions} {score!r}'.encode()):08x}"
        return cls(task=episode.task.id, seed=episode.seed, actions=actions, score=score, checksum=checksum)


def write_submission(path: Path, head: SubmissionHead, flights: Iterable[Episode]) -> None:
    """Write a submission, whole or not at all."""
    lines = [head, *map(SubmittedFlight.of, flights)]
    write_text(path, "".join(f"{line.model_dump_json(exclude_none=True)}\n" for line in lines))


def read_submission(path: Path) -> tuple[SubmissionHead, dict[TaskConfig, Results]]:
    """Read a submission, fly all its flights again, and compare each score to the last bit.

    Returns:
        The first line, and the results of each task beside the optima.

    Raises:
        OSError: if the file cannot be read.
        UnknownNameError: if there is no such task or version.
        InvalidValueError: if a line is invalid or missing, or does not fit its flight; the message names the line.
    """
    lines = enumerate(read_lines(path, LONGEST), 1)
    _, first = next(lines, (1, b""))
    head = SubmissionHead.read(first, f"line 1 of {path} is not the head of a submission")
    maps, results = split_seeds("test", head.maps), dict[TaskConfig, Results]()
    for task in [get_task(name, version) for name, version in head.tasks.items()]:
        episodes = list[Episode]()
        for seed in maps:
            number, line = next(lines, (0, b""))
            if not number:
                raise InvalidValueError(f"{path} ends too early: {task.id} map {seed} is missing")
            where = f"line {number} of {path}"
            flight = SubmittedFlight.read(line, f"{where} is not a flight")
            if (flight.task, flight.seed) != (task.id, seed):
                raise InvalidValueError(
                    f"{where} is {flight.task} map {flight.seed}, not {task.id} map {seed}: "
                    f"a submission has the first {head.maps} test maps of each task, each once and in order"
                )
            episodes.append(_fly(task, flight, where))
        results[task] = _results(task, head.agent, maps, episodes)
    for number, _ in lines:
        raise InvalidValueError(f"line {number} of {path} is one too many: {head.maps} maps of each task precede it")
    return head, results


def _fly(task: TaskConfig, flight: SubmittedFlight, where: str) -> Episode:
    try:
        episode = fly_directions(Episode(task, seed=flight.seed), [LETTERS[letter] for letter in flight.actions])
    except InvalidValueError as error:
        raise InvalidValueError(f"{where}: {error}") from None
    if changed := differences(dict(flight), dict(SubmittedFlight.of(episode))):
        raise InvalidValueError(f"{where} does not fit its flight: {'; '.join(changed)}")
    return episode


def _results(task: TaskConfig, agent: str, maps: range, episodes: Sequence[Episode]) -> Results:
    optimal = episodes_key(task, "optimal", maps, "test")
    return replace(
        shipped_results(optimal) or run_episodes(optimal),
        key=optimal._replace(agent=agent, config_hash=""),
        scores=np.array([episode.counted_score() for episode in episodes]),
        steps=np.array([episode.steps for episode in episodes]),
        deliveries=np.array([episode.deliveries_done for episode in episodes]),
        success=np.array([episode.success for episode in episodes]),
    )
