"""The folder of a run: what it is, its transcript, and what follows from that. One process at a time writes to it."""

from collections.abc import Sequence
from pathlib import Path

from filelock import FileLock
from pydantic import Field, ValidationError
from typing_extensions import Self

from drone_env.episodes.record import record_of
from drone_env.errors import InvalidValueError, text_of
from drone_env.files import lock_file, replacing
from drone_env.llm.answers import OUTCOMES, Outcome
from drone_env.llm.config import RunConfig
from drone_env.llm.pilot import Flight, Status
from drone_env.models import Count, Message, Score

CONFIG, TRANSCRIPT, EPISODES, RESULTS = "run.json", "calls.jsonl", "episodes.jsonl", "flights.jsonl"


class FlightResult(Message):
    """One flight of a run; its record is the line of the same number in `episodes.jsonl`."""

    flight: Count
    seed: Count
    repeat: Count
    status: Status
    error: str | None
    steps: Count
    ended: bool = Field(description="Whether it was flown to the end of the episode.")
    success: bool
    score: Score = Field(description="Of an unfinished flight what waiting to its end would earn.")
    turns: dict[Outcome, Count] = Field(description="How the requests for actions came out.")
    waits: Count = Field(description="Steps that are a WAIT because no answer could be used.")

    @classmethod
    def of(cls, flight: Flight) -> Self:
        """The result of a flight."""
        episode = flight.episode
        return cls(
            flight=flight.index,
            seed=flight.seed,
            repeat=flight.repeat,
            status=flight.status,
            error=flight.error,
            steps=episode.steps,
            ended=episode.ended,
            success=episode.success,
            score=episode.counted_score(),
            turns={name: flight.turns.count(name) for name in OUTCOMES},
            waits=sum(error is not None for error in flight.step_errors),
        )


class RunFolder:
    """An open run folder. To be closed.

    Raises:
        OSError: if it cannot be made or read.
        InvalidValueError: if it holds a run and is not to be resumed, or one of another configuration, or another
            process writes to it.
    """

    def __init__(self, path: Path, config: RunConfig, resume: bool) -> None:
        self.path = path
        config_path = path / CONFIG
        if path.exists() and not path.is_dir():
            raise InvalidValueError(f"{path} is a file; a run needs a folder")
        if path.is_dir() and any(path.iterdir()) and not config_path.exists() and not _begun(path):
            raise InvalidValueError(f"{path} holds other things than a run: name a new folder")
        if config_path.exists() and not resume:
            raise InvalidValueError(f"{path} holds a run already: add --resume to go on with it, or name a new folder")
        if resume and not config_path.exists():
            raise InvalidValueError(f"there is no run in {path} to resume")
        path.mkdir(parents=True, exist_ok=True)
        self._lock = _lock(path)
        try:
            if config_path.exists():
                before = load_config(path)
                changed = before.differences(config)
                if changed:
                    raise InvalidValueError(f"the run in {path} has another configuration: {'; '.join(changed)}")
            else:
                with replacing(config_path) as temporary:
                    temporary.write_text(config.model_dump_json(indent=2) + "\n", encoding="utf-8")
        except BaseException:
            self.close()
            raise

    def write_flights(self, flights: Sequence[Flight], agent: str) -> None:
        """Write the records and the results of flights, in their order; each file is there whole or not at all.

        Raises:
            OSError: if they cannot be written.
        """
        ordered = sorted(flights, key=lambda flight: flight.index)
        records = [record_of(flight.episode, agent).to_json() for flight in ordered]
        results = [FlightResult.of(flight).model_dump_json() for flight in ordered]
        for name, lines in ((EPISODES, records), (RESULTS, results)):
            with replacing(self.path / name) as temporary:
                temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")

    def close(self) -> None:
        """Let other processes in."""
        self._lock.release()


def load_config(path: Path) -> RunConfig:
    """What the run in a folder is.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if there is none, or the file is not the configuration of a run.
    """
    try:
        return RunConfig.model_validate_json((path / CONFIG).read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise InvalidValueError(f"{path}: this is not the folder of a run: there is no {CONFIG} in it") from None
    except ValidationError as error:
        raise InvalidValueError(f"{path / CONFIG} is not the configuration of a run: {text_of(error)}") from None


def load_results(path: Path) -> list[FlightResult]:
    """The results of a run, in order.

    Raises:
        OSError: if there are none yet.
        InvalidValueError: if a line is no result.
    """
    results: list[FlightResult] = []
    for number, line in enumerate((path / RESULTS).read_bytes().splitlines(), 1):
        try:
            results.append(FlightResult.model_validate_json(line))
        except ValidationError as error:
            where = f"line {number} of {path / RESULTS}"
            raise InvalidValueError(f"{where} is not the result of a flight: {text_of(error)}") from None
    return results


def _begun(path: Path) -> bool:
    """Whether the folder holds nothing but what a run that was killed at its very start leaves."""
    return all(entry.name == "lock" or entry.name.endswith(".part") for entry in path.iterdir())


def _lock(path: Path) -> FileLock:
    """Keep other processes out until the lock is released, or this process dies."""
    try:
        return lock_file(path / "lock")
    except BlockingIOError:
        raise InvalidValueError(f"another process is working on the run in {path}") from None
