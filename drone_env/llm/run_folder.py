"""The folder of a run: what it is, its transcript, and what follows from that. One process at a time writes to it."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from pydantic import Field
from typing_extensions import Self

from drone_env.errors import InvalidValueError
from drone_env.files import differences, is_begun, locked, read_file, read_lines, write_text
from drone_env.llm.answers import TURN_KINDS, TurnKind
from drone_env.llm.config import RunConfig
from drone_env.llm.flight import PilotedEpisode, Status
from drone_env.llm.transcript import LONGEST_CALL
from drone_env.models import Count, Message, Score
from drone_env.results.record import record_of
from drone_env.results.result import EpisodesKey, Results
from drone_env.results.store import Store

CONFIG, TRANSCRIPT, EPISODES, RESULTS = "run.json", "calls.jsonl", "episodes.jsonl", "flights.jsonl"
MOST_CONFIG, LONGEST_RESULT = 1 << 20, 1 << 16
"""Bytes of a configuration, and of the result of a flight."""


class PilotedRecord(Message):
    """What is kept of a piloted episode; its `EpisodeRecord` is the line of the same number in `episodes.jsonl`."""

    flight: Count
    seed: Count
    repeat: Count
    status: Status
    error: str | None
    steps: Count
    ended: bool = Field(description="Whether it was flown to the end of the episode.")
    success: bool
    score: Score = Field(description="Of an unfinished flight what waiting to its end would earn.")
    turns: dict[TurnKind, Count] = Field(description="How the requests for actions came out.")
    waits: Count = Field(description="Steps that are a WAIT because no answer could be used.")

    @classmethod
    def of(cls, flown: PilotedEpisode) -> Self:
        """What is kept of an episode."""
        episode = flown.episode
        return cls(
            flight=flown.index,
            seed=episode.seed,
            repeat=flown.repeat,
            status=flown.status,
            error=flown.error,
            steps=episode.steps,
            ended=episode.ended,
            success=episode.success,
            score=episode.counted_score(),
            turns={name: flown.turns.count(name) for name in TURN_KINDS},
            waits=sum(error is not None for error in flown.step_errors),
        )


def results_of(config: RunConfig, records: Sequence[PilotedRecord], optima: Mapping[int, float]) -> Results:
    """The results of the flights that count: all that did not error.

    Args:
        config: The run.
        records: Its flights.
        optima: The optimum of each map, as far as it is known.
    """
    counted = [record for record in records if record.status != "errored"]
    return Results.of_rows(
        EpisodesKey(config.task, config.task_version, config.split, config.seeds, config.model),
        seeds=[record.seed for record in counted],
        scores=[record.score for record in counted],
        steps=[record.steps for record in counted],
        success=[record.success for record in counted],
        optimal_scores=[optima.get(record.seed) for record in counted],
    )


class EpisodeIds:
    """What a store calls the flights of the run in a folder.

    Raises:
        OSError: if no call of it was made.
        InvalidValueError: if the transcript cannot be one.
    """

    def __init__(self, path: Path) -> None:
        # It holds the time of the run's first call, and is the same for all parts of the run.
        self._run = next(read_lines(path / TRANSCRIPT, LONGEST_CALL), b"")

    def of(self, flight: int) -> str:
        """The id of the flight of a number."""
        return hashlib.sha256(b"%d %s" % (flight, self._run)).hexdigest()[:16]


class RunFolder:
    """An open run folder. To be closed.

    Raises:
        OSError: if it cannot be made or read.
        InvalidValueError: if it holds a run and is not to be resumed, or one of another configuration, or another
            process writes to it.
    """

    def __init__(self, path: Path, config: RunConfig, resume: bool) -> None:
        self.path = path
        self._agent = config.model
        config_path = path / CONFIG
        begun = is_begun(path, CONFIG, "a run")
        if begun and not resume:
            raise InvalidValueError(f"{path} holds a run already: add --resume to go on with it, or name a new folder")
        path.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            opened.enter_context(locked(path / "lock", f"another process is working on the run in {path}"))
            if config_path.exists():
                changed = differences(dict(load_config(path)), dict(config))
                if changed:
                    raise InvalidValueError(f"the run in {path} has another configuration: {'; '.join(changed)}")
            else:
                write_text(config_path, config.model_dump_json(indent=2) + "\n")
            self._opened = opened.pop_all()

    def write_flights(self, flights: Sequence[PilotedEpisode]) -> None:
        """Write the records and the results of ordered flights; each file is written whole or not at all.

        Raises:
            OSError: if they cannot be written.
        """
        records = [record_of(flown.episode, self._agent).to_json() for flown in flights]
        results = [PilotedRecord.of(flown).model_dump_json() for flown in flights]
        for name, lines in ((EPISODES, records), (RESULTS, results)):
            write_text(self.path / name, "".join(f"{line}\n" for line in lines))

    def keep(self, flown: PilotedEpisode, store: Store) -> None:
        """Keep an episode that was flown to its end in a store: once, however often the run is gone on with.

        Raises:
            StoreError: if the store refuses it.
        """
        if flown.episode.ended:
            store.add_episode(flown.episode, self._agent, EpisodeIds(self.path).of(flown.index))

    def close(self) -> None:
        """Let other processes in."""
        self._opened.close()


def runs_in(path: Path) -> list[Path]:
    """The folder itself; or those of the runs in it, as `--prompts` makes them, where it is of none itself."""
    inside = sorted(file.parent for file in path.glob(f"*/{CONFIG}"))
    return [path] if os.path.lexists(path / CONFIG) else inside or [path]


def load_config(path: Path) -> RunConfig:
    """What the run in a folder is.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if there is none, or the file is not the configuration of a run.
    """
    try:
        text = read_file(path / CONFIG, MOST_CONFIG)
    except (FileNotFoundError, NotADirectoryError):
        raise InvalidValueError(f"{path}: this is not the folder of a run: there is no {CONFIG} in it") from None
    return RunConfig.read(text, f"{path / CONFIG} is not the configuration of a run")


def load_results(path: Path) -> list[PilotedRecord]:
    """The results of a run, in order.

    Raises:
        OSError: if there are none yet.
        InvalidValueError: if a line is no result.
    """
    lines = enumerate(read_lines(path / RESULTS, LONGEST_RESULT), 1)
    wrong = f"of {path / RESULTS} is not the result of a flight"
    return [PilotedRecord.read(line, f"line {number} {wrong}") for number, line in lines]
