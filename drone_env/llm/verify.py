"""Verify a run folder: fly every flight again from the model's own answers."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.flights.record import EpisodeRecord, read_records, record_of
from drone_env.llm.config import RunConfig
from drone_env.llm.prompt import Prompt
from drone_env.llm.run_folder import EPISODES, TRANSCRIPT, FlightResult, load_config, load_results
from drone_env.llm.text_episode import EpisodeRun
from drone_env.llm.transcript import Call, CallKey, read_calls


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
    calls = list(read_calls(path / TRANSCRIPT))
    answers = {call.key: call for call in calls if call.answer is not None}
    prompt, known, used = config.load_prompt(), {call.key: call for call in calls} | answers, set[CallKey]()
    numbers = [result.flight for result in results]
    try:
        if len(results) != len(records):
            raise InvalidValueError(f"it contains {len(records)} records for {len(results)} flights")
        if numbers != sorted({number for number in numbers if number < config.flights}):
            raise InvalidValueError(f"the numbers of the flights are not those of {config.flights} flights")
        if lost := {key.flight for key in answers} - set(numbers):
            # A run without its worst flights would look better than it is.
            raise InvalidValueError(f"flight {min(lost)} was begun but is not among the results: resume the run")
        flights = [_flown_again(config, prompt, *flown, known, used) for flown in zip(results, records, strict=True)]
        if used != answers.keys():
            raise InvalidValueError(f"{len(answers.keys() - used)} answers belong to no flight")
    except DroneEnvError as error:
        raise InvalidValueError(f"{path}: {error}") from None
    return VerifiedRun(path, config, results, flights, calls)


def _flown_again(
    config: RunConfig,
    prompt: Prompt,
    result: FlightResult,
    record: EpisodeRecord,
    calls: Mapping[CallKey, Call],
    used: set[CallKey],
) -> EpisodeRun:
    """A flight from its answers, which must give its result and record; adds the calls with an answer to `used`."""
    try:
        run = config.episode_run(result.flight, prompt)
        while run.messages:
            key = run.key
            call = calls.get(key)
            if call is not None and call.answer is not None:
                used.add(key)
                run.answer(call.answer_to(run.request(call.changes)))
            # After its last answer the flight ended with the status of its result, which is compared below.
            elif result.status == "budget_stop" or (result.status == "errored" and call is not None):
                run.stop(result.status, result.error or "")
            else:
                # An errored flight does not count, so the transcript must contain its failed call.
                missing = "has neither an answer nor a failure" if result.status == "errored" else "has no answer"
                raise InvalidValueError(f"call {key} {missing}, but the status of the flight is {result.status}")
        if (record_of(run.episode, config.model), FlightResult.of(run)) != (record, result):
            raise InvalidValueError("its record and result do not follow from the model's answers")
    except DroneEnvError as error:
        raise InvalidValueError(f"flight {result.flight}: {error}") from None
    return run
