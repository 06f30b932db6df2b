"""Verify a run folder: fly every flight again from the model's own answers."""

import asyncio
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.config import RunConfig
from drone_env.llm.run_folder import EPISODES, TRANSCRIPT, FlightResult, load_config, load_results
from drone_env.llm.text_episode import CallFailedError, Flight, LimitReachedError, fly
from drone_env.llm.transcript import SENT, Call, CallKey, read_calls, read_sent
from drone_env.results.record import read_records, record_of, replay


@dataclass(frozen=True)
class VerifiedRun:
    """A verified run.

    Attributes:
        path: Its folder.
        config: Its configuration.
        results: The result of each flight.
        flights: The flights, in the same order.
        calls: Its transcript.
        requests: Number of requests sent.
    """

    path: Path
    config: RunConfig
    results: list[FlightResult]
    flights: list[Flight]
    calls: list[Call]
    requests: int


def verified_run(path: Path) -> VerifiedRun:
    """Verify a run: its records and results follow from the answers in its transcript."""
    config = load_config(path)
    results, records = load_results(path), list(read_records(path / EPISODES))
    calls = list(read_calls(path / TRANSCRIPT))
    answers = {call.key: call for call in calls if call.answer is not None}
    failed = {call.key for call in calls if call.answer is None}
    if len(results) != len(records):
        raise InvalidValueError(f"{path} contains {len(records)} records for {len(results)} flights")
    numbers = [result.flight for result in results]
    if numbers != sorted(set(numbers)) or (numbers and numbers[-1] >= config.flights):
        raise InvalidValueError(f"{path}: the numbers of the flights are not those of {config.flights} flights")
    lost = sorted({key.flight for key in answers} - set(numbers))
    if lost:
        # A run without its worst flights would look better than it is.
        raise InvalidValueError(f"{path}: flight {lost[0]} was begun but is not among the results: resume the run")
    used: set[CallKey] = set()
    prompt = config.load_prompt()

    def replayed(result: FlightResult) -> Flight:
        async def ask(flight: Flight) -> Answer:
            key = flight.key
            if key in answers:
                used.add(key)
                flight.changes = answers[key].changes
                return answers[key].answer_to(flight.request)
            # After its last answer the flight ended with the status of its result, which is compared below.
            if result.status == "errored" and key in failed:
                raise CallFailedError(result.error or "")
            if result.status == "budget_stop":
                raise LimitReachedError(result.error or "")
            # An errored flight does not count, so the transcript must contain its failed call.
            missing = "has neither an answer nor a failure" if result.status == "errored" else "has no answer"
            raise InvalidValueError(f"call {key} {missing}, but the status of the flight is {result.status}")

        return asyncio.run(fly(config.flight(result.flight, prompt), ask))

    flights = list[Flight]()
    for result, record in zip(results, records, strict=True):
        try:
            flight = replayed(result)
            flights.append(flight)
            fits = record_of(flight.episode, config.model) == record
            if not fits:
                replay(record, config.profile)  # Its error is more precise if the record contradicts itself.
        except DroneEnvError as error:
            raise InvalidValueError(f"{path}: flight {result.flight}: {error}") from None
        if not fits or FlightResult.of(flight) != result:
            raise InvalidValueError(f"{path}: flight {result.flight} does not follow from the model's answers")
    if used != answers.keys():
        raise InvalidValueError(f"{path}: {len(answers.keys() - used)} answers belong to no flight")
    sent = list(read_sent(path / SENT))
    made = Counter(call.key for call in calls for _ in range(len(call.failures) + (call.answer is not None)))
    if missing := made - Counter(sent):
        raise InvalidValueError(f"{path}: {SENT} lacks a request of call {min(missing)}")
    return VerifiedRun(path, config, results, flights, calls, len(sent))
