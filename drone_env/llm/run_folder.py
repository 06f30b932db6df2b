"""The folder of a run: configuration, transcript and records. One process at a time writes to it."""

import hashlib
from collections import Counter
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.files import differences, is_begun, locked, read_file, read_lines, write_text
from drone_env.flights.record import record_of
from drone_env.llm.answers import TURN_KINDS, TurnKind
from drone_env.llm.budget import Budget, Options
from drone_env.llm.config import RunConfig
from drone_env.llm.text_episode import EpisodeRun
from drone_env.llm.transcript import LONGEST_CALL, answered_calls, read_calls
from drone_env.results.result import EpisodesKey, Results

CONFIG, TRANSCRIPT, EPISODES = "run.json", "calls.jsonl", "episodes.jsonl"
MAX_CONFIG = 1 << 20
"""Bytes of a configuration."""
MAX_ERRORED = 0.05
Verdict = Literal["valid", "incomplete", "invalid", "stopped"]


@dataclass(frozen=True)
class Run:
    """A run and its flights, flown by the model's own answers.

    Attributes:
        path: Its folder.
        config: Its configuration.
        flights: All flights that began and were not abandoned, in order.
        budget: The requests and tokens that they took.
        fatal: Why the endpoint refused every call, if it did.
    """

    path: Path
    config: RunConfig
    flights: list[EpisodeRun]
    budget: Budget
    fatal: str | None = None

    @property
    def counted(self) -> list[EpisodeRun]:
        """The flights that count: all that did not error."""
        return [run for run in self.flights if run.status != "errored"]

    @property
    def verdict(self) -> tuple[Verdict, str]:
        """The verdict on the run, and why it is not valid.

        `stopped` if the endpoint refuses every call; `invalid` if too many flights errored; `incomplete` if some were
        cut short or not begun.
        """
        flown, errored = len(self.flights), len(self.flights) - len(self.counted)
        if self.fatal is not None:
            return "stopped", self.fatal
        if errored > MAX_ERRORED * flown:
            return "invalid", f"{errored} of {flown} flights errored, more than {MAX_ERRORED:.0%}"
        cut, left = sum(run.status == "budget_stop" for run in self.flights), self.config.flights - flown
        return ("incomplete", f"flights cut short: {cut}; not begun: {left}") if cut or left else ("valid", "")

    def results(self, optima: Mapping[int, float | None] | None = None) -> Results:
        """The results of the flights that count.

        Args:
            optima: The optimum of each map, if it is known.
        """
        config, counted, best, ids = self.config, self.counted, optima or {}, EpisodeIds(self.path)
        return Results.of_rows(
            EpisodesKey(config.task, config.task_version, config.split, config.seeds, config.model),
            ids=[ids.of(run.index) for run in counted],
            seeds=[run.seed for run in counted],
            scores=[run.score for run in counted],
            steps=[run.episode.steps for run in counted],
            success=[run.success for run in counted],
            optimal_scores=[best.get(run.seed) for run in counted],
        )


def turns_of(flights: Iterable[EpisodeRun]) -> dict[TurnKind, int]:
    """The number of requests for actions by outcome."""
    counts = Counter(turn for run in flights for turn in run.turns)
    return {name: counts[name] for name in TURN_KINDS}


def read_run(path: Path) -> Run:
    """Fly the flights of a run again, from the answers in its transcript.

    Raises:
        OSError: if a file cannot be read.
        InvalidValueError: if a file is damaged, or an answer does not belong to the run.
    """
    config, calls, budget = load_config(path), read_calls(path / TRANSCRIPT), Budget(Options())
    budget.resume(calls)
    prompt, answered, flights = config.load_prompt(), answered_calls(calls), list[EpisodeRun]()
    failed = {call.key: call.outcome for call in calls if call.answer is None}
    for number in sorted({call.flight for call in calls}):
        run, answers = config.episode_run(number, prompt), answered.get(number, {})
        try:
            if run.replay(answers) < len(answers) or number >= config.flights:
                raise InvalidValueError("it has an answer too many")
        except DroneEnvError as error:
            raise InvalidValueError(f"{path}: flight {number}: {error}") from None
        if run.messages:
            run.stop(
                "errored" if failed.get(run.next_key) == "api_error" else "budget_stop", "its next call has no answer"
            )
        if run.begun:
            flights.append(run)
    return Run(path, config, flights, budget)


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
    with locked(path / "lock", f"another process is working on the run in {path}"):
        if (path / CONFIG).exists():
            if changed := "; ".join(differences(dict(load_config(path)), dict(config))):
                raise InvalidValueError(f"the run in {path} has another configuration: {changed}; begin a new run")
        else:
            write_text(path / CONFIG, config.model_dump_json(indent=2) + "\n")
        yield


def write_records(run: Run) -> None:
    """Write the records of the flights; the file is written whole or not at all."""
    lines = (f"{record_of(flight.episode, run.config.model).to_json()}\n" for flight in run.flights)
    write_text(run.path / EPISODES, "".join(lines))


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
