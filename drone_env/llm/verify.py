"""Verify a run folder: fly every flight again from the model's own answers."""

from dataclasses import dataclass
from pathlib import Path

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.flights.record import read_records, record_of
from drone_env.llm.config import RunConfig
from drone_env.llm.run_folder import EPISODES, TRANSCRIPT, FlightResult, load_config, load_results
from drone_env.llm.text_episode import EpisodeRun
from drone_env.llm.transcript import Call, answered_calls, read_calls


@dataclass(frozen=True)
class VerifiedRun:
    """A verified run.

    Attributes:
        path: Its folder.
        config: Its configuration.
        results: The result of each flight.
        flights: The flights, in the same order.
        calls: Its transcript.
    """

    path: Path
    config: RunConfig
    results: list[FlightResult]
    flights: list[EpisodeRun]
    calls: list[Call]


def verified_run(path: Path) -> VerifiedRun:
    """Verify a run: its records and results follow from the answers in its transcript.

    Raises:
        OSError: if a file cannot be read.
        InvalidValueError: if they do not, or a file is damaged.
    """
    config, results, records = load_config(path), load_results(path), list(read_records(path / EPISODES))
    calls, prompt = read_calls(path / TRANSCRIPT), config.load_prompt()
    answered = answered_calls(calls)
    failed = {call.key for call in calls if call.answer is None}
    numbers = [result.flight for result in results]
    try:
        if len(results) != len(records):
            raise InvalidValueError(f"it contains {len(records)} records for {len(results)} flights")
        if numbers != sorted({number for number in numbers if number < config.flights}):
            raise InvalidValueError(f"the numbers of the flights are not those of {config.flights} flights")
        if lost := answered.keys() - set(numbers):
            # A run without its worst flights would look better than it is.
            raise InvalidValueError(f"flight {min(lost)} was begun but is not among the results: resume the run")
        flights, left = list[EpisodeRun](), sum(map(len, answered.values()))
        for result, record in zip(results, records, strict=True):
            try:
                run = config.episode_run(result.flight, prompt)
                left -= run.replay(answered.get(result.flight, {}))
                _check(run, run.next_key in failed, result, record_of(run.episode, config.model) == record)
            except DroneEnvError as error:
                raise InvalidValueError(f"flight {result.flight}: {error}") from None
            flights.append(run)
        if left:
            raise InvalidValueError(f"{left} answers belong to no flight")
    except DroneEnvError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    return VerifiedRun(path, config, results, flights, calls)


def _check(run: EpisodeRun, failed: bool, result: FlightResult, recorded: bool) -> None:
    """Check that a flight with all its answers gives its result; stops it as the result says.

    Args:
        run: The flight.
        failed: Whether the transcript has its next call, without an answer.
        result: The result.
        recorded: Whether it gives its record.
    """
    if run.messages:
        if result.status == "budget_stop" or (result.status == "errored" and failed):
            run.stop(result.status, result.error or "")
        else:
            # An errored flight does not count, so the transcript must contain its failed call.
            missing = "has neither an answer nor a failure" if result.status == "errored" else "has no answer"
            raise InvalidValueError(f"call {run.next_key} {missing}, but the status of the flight is {result.status}")
    if not recorded or FlightResult.of(run) != result:
        raise InvalidValueError("its record and result do not follow from the model's answers")
