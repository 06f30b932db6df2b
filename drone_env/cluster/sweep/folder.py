"""The folder of a sweep: what it is, how each trial stands, which settings were stopped.

    sweep.json             what the sweep is
    stopped.json           which settings were stopped, where, and by which values
    trials/NAME/trial.json how a trial stands: rungs reached, result, error
    trials/NAME/parts.jsonl   when it was taken up, by whom, and at how many episodes
    trials/NAME/           the files of its training run
    report.md, report.json, curves.png, scores.png

One process drives a sweep at a time, and one trains a trial: locks say so, which end with their process.
"""

import json
import os
import socket
from collections.abc import Sequence
from contextlib import AbstractContextManager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic_core import to_json

from drone_env.cluster.sweep.config import SweepConfig, Trial
from drone_env.errors import InvalidValueError, text_of
from drone_env.files import is_begun, locked, read_file, read_lines, write_text
from drone_env.models import Count, Message

CONFIG, STOPPED, STATE, PARTS = "sweep.json", "stopped.json", "trial.json", "parts.jsonl"
LOCK_SECONDS = 60.0
MOST_FILE = 16 << 20
"""Bytes of one of its files."""


class MapScores(Message):
    """How a finished network flies the test maps."""

    scores: list[float] = Field(description="The graded score on each map.")
    optima: list[float] | None = Field(description="The optimum of each map; null where no planner knows it.")
    success_rate: float


class TrialState(Message):
    """How a trial stands."""

    status: Literal["unfinished", "finished", "failed"] = "unfinished"
    rungs: dict[str, float] = Field(default_factory=dict, description="Best validation score by number of episodes.")
    episodes: Count = 0
    steps: Count = 0
    updates: Count = 0
    seconds: float = 0.0
    curve: list[tuple[int, float]] = Field(
        default_factory=list[tuple[int, float]],
        strict=False,
        description="Episodes, and the score of the validation then.",
    )
    validation_score: float | None = None
    validation_optimum: float | None = None
    network: str | None = Field(default=None, description="Digest of the best network's parameters.")
    test: MapScores | None = None
    error: str | None = None


class StoppedSettings(Message):
    """What was decided at a rung: the mean validation score of each setting there, and which were stopped."""

    episodes: Count
    values: dict[str, float]
    stopped: list[int]


class SweepFolder:
    """A sweep's folder, as the driver and the workers see it.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, config: SweepConfig) -> None:
        """Make the folder for a sweep, or find that it is that sweep's.

        Raises:
            OSError: if it cannot be made or read.
            InvalidValueError: if it holds something else, or a sweep of another configuration.
        """
        if is_begun(self.path, CONFIG, "a sweep"):
            changed = self.config().differences(config)
            if changed:
                raise InvalidValueError(f"the sweep in {self.path} has another configuration: {'; '.join(changed)}")
            return
        self.path.mkdir(parents=True, exist_ok=True)
        _write(self.path / CONFIG, config)

    def config(self) -> SweepConfig:
        """What the sweep is.

        Raises:
            OSError: if it cannot be read.
            InvalidValueError: if the file is no configuration of a sweep.
        """
        return _read(self.path / CONFIG, TypeAdapter(SweepConfig))

    def driving(self) -> AbstractContextManager[None]:
        """Keep other drivers out.

        Raises:
            InvalidValueError: if there is one.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        return locked(self.path / "lock", f"another process is driving the sweep in {self.path}")

    def training(self, trial: Trial) -> AbstractContextManager[None]:
        """Keep other processes out of the trial's folder; waits a minute for one that is being ended.

        Raises:
            InvalidValueError: if another process trains it still.
        """
        folder = self.folder(trial)
        folder.mkdir(parents=True, exist_ok=True)
        return locked(folder / "lock", f"another process is still training in {folder}", LOCK_SECONDS)

    def folder(self, trial: Trial) -> Path:
        """Where a trial's files lie."""
        return self.path / "trials" / trial.name

    def state(self, trial: Trial) -> TrialState:
        """How a trial stands.

        Raises:
            InvalidValueError: if its file is damaged.
        """
        path = self.folder(trial) / STATE
        return _read(path, TypeAdapter(TrialState)) if path.exists() else TrialState()

    def set_state(self, trial: Trial, state: TrialState) -> None:
        """Write how a trial stands, whole or not at all."""
        self.folder(trial).mkdir(parents=True, exist_ok=True)
        _write(self.folder(trial) / STATE, state)

    def note_part(self, trial: Trial, episodes: int) -> None:
        """Note that this process takes the trial up, with this many episodes flown."""
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        part = {"at": now, "host": socket.gethostname(), "pid": os.getpid(), "episodes": episodes}
        with (self.folder(trial) / PARTS).open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(part)}\n")

    def parts(self, trial: Trial) -> list[dict[str, Any]]:
        """Every time that the trial was taken up."""
        path = self.folder(trial) / PARTS
        if not path.exists():
            return []
        return [_parsed(path, line, TypeAdapter(dict[str, Any])) for line in read_lines(path, MOST_FILE)]

    def stopped(self) -> list[StoppedSettings]:
        """What was decided so far, one entry a rung.

        Raises:
            InvalidValueError: if the file is damaged.
        """
        path = self.path / STOPPED
        return _read(path, TypeAdapter(list[StoppedSettings])) if path.exists() else []

    def set_stopped(self, decisions: Sequence[StoppedSettings]) -> None:
        """Write what was decided."""
        _write(self.path / STOPPED, decisions)


def _write(path: Path, value: Message | Sequence[Message]) -> None:
    write_text(path, to_json(value, indent=2).decode() + "\n")


def _read(path: Path, kind: TypeAdapter[Any]) -> Any:
    return _parsed(path, read_file(path, MOST_FILE), kind)


def _parsed(path: Path, text: bytes, kind: TypeAdapter[Any]) -> Any:
    try:
        return kind.validate_json(text)
    except ValidationError as error:
        raise InvalidValueError(f"{path} is damaged: {text_of(error)}") from None
