"""Verifies a run folder: every flight is flown again, from the model's own answers."""

import asyncio
from dataclasses import dataclass
from pathlib import Path

from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.llm.answers import Reading
from drone_env.llm.config import RunConfig, request_bodies
from drone_env.llm.content import ChatMessage
from drone_env.llm.flight import CallFailedError, PilotedEpisode, fly
from drone_env.llm.limiter import LimitReachedError
from drone_env.llm.run_folder import EPISODES, TRANSCRIPT, PilotedRecord, load_config, load_results
from drone_env.llm.transcript import Call, CallKey, digest, read_calls
from drone_env.results.record import EpisodeRecord, read_records, record_of, replay


@dataclass(frozen=True)
class VerifiedRun:
    """A verified run.

    Attributes:
        path: Its folder.
        config: Its configuration.
        results: Of each flight.
        records: Of each flight, in the same order.
        calls: All of the transcript.
    """

    path: Path
    config: RunConfig
    results: list[PilotedRecord]
    records: list[EpisodeRecord]
    calls: list[Call]


def verified_run(path: Path) -> VerifiedRun:
    """Verify a run: its records and results follow from the answers in its transcript.

    Raises:
        OSError: if a file of it cannot be read.
        InvalidValueError: if it is damaged, or anything in it does not follow from its answers; the message says what.
    """
    config = load_config(path)
    results, records = load_results(path), list(read_records(path / EPISODES))
    calls = [call for _, call in read_calls(path / TRANSCRIPT)]
    answers = {call.key: call for call in calls if call.answer is not None}
    failed = {call.key for call in calls if call.answer is None}
    if len(results) != len(records):
        raise InvalidValueError(f"{path} holds {len(records)} records for {len(results)} flights")
    numbers = [result.flight for result in results]
    if numbers != sorted(set(numbers)) or (numbers and numbers[-1] >= config.flights):
        raise InvalidValueError(f"{path}: the flights are not numbered as those of {config.flights}")
    begun = {call.flight for call in answers.values()}
    lost = sorted(begun - set(numbers))
    if lost:
        # Leaving out the flights that went badly would make a run look better than it was.
        raise InvalidValueError(f"{path}: flight {lost[0]} was begun but is not among the results: resume the run")
    used: set[CallKey] = set()
    bodies, prompt = request_bodies(config), config.load_prompt()

    async def replayed(ended: PilotedRecord) -> PilotedEpisode:
        flown = PilotedEpisode.begin(config, ended.flight)
        body = bodies[flown.repeat]

        async def ask(key: CallKey, messages: list[ChatMessage]) -> Reading:
            call = answers.get(key)
            if call is not None and call.answer is not None:
                call.require_same(messages, digest({"body": body, "messages": messages}), body.get("seed"))
                used.add(key)
                return prompt.read_answer(call.answer)
            # After the last answer the flight ended as its result says, which is compared with the rest of it.
            if ended.status == "errored" and key in failed:
                raise CallFailedError(ended.error or "")
            if ended.status == "budget_stop":
                raise LimitReachedError(ended.error or "")
            # An errored flight does not count, so its call must have failed.
            missing = "has neither an answer nor a failure" if ended.status == "errored" else "has no answer"
            raise InvalidValueError(f"call {key} {missing}, but the flight is said to be {ended.status}")

        return await fly(flown, prompt, config.history, ask)

    for result, record in zip(results, records, strict=True):
        try:
            flown = asyncio.run(replayed(result))
            fits = record_of(flown.episode, config.model) == record
            if not fits:
                replay(record, config.profile)  # says more about a record that does not even fit itself
        except DroneEnvError as error:
            raise InvalidValueError(f"{path}: flight {result.flight}: {error}") from None
        if not fits or PilotedRecord.of(flown) != result:
            raise InvalidValueError(f"{path}: flight {result.flight} is not what the model's answers come to")
    if used != answers.keys():
        raise InvalidValueError(f"{path}: {len(answers.keys() - used)} answers belong to no flight")
    return VerifiedRun(path, config, results, records, calls)
