"""The folder of a run: configuration, transcript, records and results. One process at a time writes to it."""

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field
from typing_extensions import Self

from drone_env.errors import InvalidValueError
from drone_env.files import differences, is_begun, locked, read_file, read_lines, write_text
from drone_env.flights.record import record_of
from drone_env.llm.answers import TURN_KINDS, TurnKind
from drone_env.llm.config import RunConfig
from drone_env.llm.text_episode import EpisodeRun, Status
from drone_env.llm.transcript import LONGEST_CALL
from drone_env.models import Count, Score, StrictModel
from drone_env.results.result import EpisodesKey, Results

CONFIG, TRANSCRIPT, EPISODES, RESULTS = "run.json", "calls.jsonl", "episodes.jsonl", "flights.jsonl"
MAX_CONFIG, MAX_RESULT = 1 << 20, 1 << 16
"""Bytes of a configuration, and of the result of a flight."""


class FlightResult(StrictModel):
    """The result of a flight; its `EpisodeRecord` is the line of the same number in `episodes.jsonl`."""

    flight: Count
    seed: Count
    repeat: Count
    status: Status
    error: str | None
    steps: Count
    ended: bool = Field(description="Whether the episode was flown to its end.")
    success: bool
    score: Score = Field(description="The score; of an unfinished flight, the score of waiting to the end.")
    turns: dict[TurnKind, Count] = Field(description="Number of requests for actions by outcome.")
    waits: Count = Field(description="Steps that are a WAIT because the answer was unusable.")

    @classmethod
    def of(cls, run: EpisodeRun) -> Self:
        """The result of a flight."""
        return cls(
            flight=run.index,
            seed=run.seed,
            repeat=run.repeat,
            status=run.status,
            error=run.error,
            steps=len(run.flown),
            ended=run.episode.ended,
            success=run.success,
            score=run.score,
            turns={name: run.turns.count(name) for name in TURN_KINDS},
            waits=sum(error is not None for error in run.step_errors),
        )


def results_of(config: RunConfig, flights: Sequence[FlightResult], optima: Mapping[int, float | None]) -> Results:
    """The results of the flights that count: all that did not error.

    Args:
        config: The run.
        flights: The results of its flights.
        optima: The optimum of each map, if it is known.
    """
    counted = [result for result in flights if result.status != "errored"]
    return Results.of_rows(
        EpisodesKey(config.task, config.task_version, config.split, config.seeds, config.model),
        seeds=[result.seed for result in counted],
        scores=[result.score for result in counted],
        steps=[result.steps for result in counted],
        success=[result.success for result in counted],
        optimal_scores=[optima.get(result.seed) for result in counted],
    )


def turns_of(flights: Sequence[FlightResult]) -> dict[TurnKind, int]:
    """The number of requests for actions by outcome."""
    return {name: sum(flight.turns.get(name, 0) for flight in flights) for name in TURN_KINDS}


class EpisodeIds:
    """The ids in a store of the flights of the run in a folder.

    Raises:
        OSError: if the run has made no call.
        InvalidValueError: if the transcript is damaged.
    """

    def __init__(self, path: Path) -> None:
        # The first call contains its time, and stays the same when the run is resumed.
        self._run = next(read_lines(path / TRANSCRIPT, LONGEST_CALL), b"")

    def of(self, flight: int) -> str:
        """The id of the flight with this number."""
        return hashlib.sha256(b"%d %s" % (flight, self._run)).hexdigest()[:16]


@contextmanager
def locked_run(path: Path, config: RunConfig, resume: bool) -> Generator[None, None, None]:
    """Begin or continue the run in a folder, and hold its lock until the end of the `with`."""
    begun = is_begun(path, CONFIG, "a run")
    if begun and not resume:
        raise InvalidValueError(f"{path} contains a run: add --resume to continue it, or name a new folder")
    path.mkdir(parents=True, exist_ok=True)
    with locked(path / "lock", f"another process is working on the run in {path}"):
        if (path / CONFIG).exists():
            changed = differences(dict(load_config(path)), dict(config))
            if changed:
                raise InvalidValueError(f"the run in {path} has another configuration: {'; '.join(changed)}")
        else:
            write_text(path / CONFIG, config.model_dump_json(indent=2) + "\n")
        yield


def write_flights(path: Path, config: RunConfig, flights: Sequence[EpisodeRun]) -> None:
    """Write the records and the results of ordered flights; each file is written whole or not at all."""
    records = [record_of(run.episode, config.model).to_json() for run in flights]
    results = [FlightResult.of(run).model_dump_json() for run in flights]
    for name, lines in ((EPISODES, records), (RESULTS, results)):
        write_text(path / name, "".join(f"{line}\n" for line in lines))


def load_config(path: Path) -> RunConfig:
    """The configuration of the run in a folder.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if there is none, or it is invalid.
    """
    try:
        text = read_file(path / CONFIG, MAX_CONFIG)
    except (FileNotFoundError, NotADirectoryError):
        raise InvalidValueError(f"{path} is not the folder of a run: it has no {CONFIG}") from None
    return RunConfig.read(text, f"{path / CONFIG} is not the configuration of a run")


def load_results(path: Path) -> list[FlightResult]:
    """The results of a run, in order."""
    lines = enumerate(read_lines(path / RESULTS, MAX_RESULT), 1)
    wrong = f"of {path / RESULTS} is not the result of a flight"
    return [FlightResult.read(line, f"line {number} {wrong}") for number, line in lines]
