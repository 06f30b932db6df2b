"""What all flights of a run share: its transcript, its cache, and what may be sent."""

from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from drone_env.errors import DroneEnvError, EndpointError, InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.cache import AnswerCache
from drone_env.llm.clock import Clock
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.limits import Spending
from drone_env.llm.pace import Pace
from drone_env.llm.pilot import CallFailedError
from drone_env.llm.transcript import Call, CallKey, Transcript


class StoppedError(DroneEnvError):
    """The run is being stopped: this flight is left where it is."""


class Watcher(Protocol):
    """Is told what happens."""

    def called(self, call: Call) -> None:
        """A call was made."""
        ...

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed; the next one comes after so many seconds."""
        ...


class Known(NamedTuple):
    """What is there of a call before it is made: an answer, and whether it is from the cache."""

    answer: Answer | None
    cached: bool


class Desk(Protocol):
    """Where flights ask before they send and report before they go on. It may stand in another process."""

    async def known(self, key: CallKey, request: str, cache_key: str) -> Known:
        """What is there of a call; of its flight nothing else is under way.

        Raises:
            StoppedError: if the run is being stopped for the sake of another call.
            InvalidValueError: if the transcript holds another request under this key.
        """
        ...

    async def enter(self, key: CallKey) -> float:
        """Wait until a request may be sent, count it, and return the seconds that are left to the run.

        Raises:
            StoppedError: if the run is being stopped.
            LimitReachedError: if it must not be sent.
        """
        ...

    async def leave(self, key: CallKey, answered: bool, overloaded: bool = False, pause: float = 0.0) -> None:
        """The request is over. An overloaded endpoint is sent nothing for `pause` seconds, and less from then on."""
        ...

    async def record(self, call: Call, cache_key: str) -> Call:
        """Put a call into the transcript. It is there, as it is returned, before anything is done with it.

        Raises:
            OSError: if it cannot be written.
        """
        ...

    async def failed(self, status: int, reason: str, retried: bool, fatal: bool) -> None:
        """A call brought no answer after all tries.

        Raises:
            CallFailedError: always, but
            StoppedError: where the run is being stopped.
        """
        ...

    def waiting(self, seconds: float, reason: str) -> None:
        """A try failed; the next one comes after so many seconds."""
        ...


@dataclass
class _Place:
    """A request that has been let through: when it was sent, and for how many tokens it counts."""

    gate: AbstractAsyncContextManager[None]
    sent_at: float = 0.0
    expected: float = 0.0


class LocalDesk:
    """The desk itself.

    Attributes:
        fatal: Why no further call makes sense; None while they do.
    """

    def __init__(
        self,
        host: str,
        transcript: Transcript,
        spending: Spending,
        gate: AdaptiveGate,
        pace: Pace,
        cache: AnswerCache | None,
        watcher: Watcher,
        clock: Clock | None = None,
    ) -> None:
        self.fatal: EndpointError | None = None
        self._host = host
        self._transcript = transcript
        self._spending = spending
        self._gate = gate
        self._pace = pace
        self._cache = cache
        self._watcher = watcher
        self._clock = clock or Clock()
        self._any_answer = any(call.answer is not None for call in transcript.calls)
        self._places: dict[int, _Place] = {}
        self._expected: dict[int, float] = {}
        self._begun: dict[int, int] = {}
        for call in transcript.calls:
            spending.add(call)

    async def known(self, key: CallKey, request: str, cache_key: str) -> Known:
        """See `Desk`."""
        # A flight that begins anew elsewhere, its process having died, has left its place.
        await self._free(key.flight)
        self._begun[key.flight] = self._begun.get(key.flight, 0) + 1
        call = self._transcript.answered.get(key)
        if call is not None and call.answer is not None:
            if call.request_digest != request:
                raise InvalidValueError(f"{self._transcript.path}: call {key} asks something else than this run would")
            return Known(call.answer, False)
        self._check_going_on()
        answer = self._cache.get(cache_key) if self._cache else None
        return Known(answer, answer is not None)

    async def enter(self, key: CallKey) -> float:
        """See `Desk`."""
        flight, begun = key.flight, self._begun.get(key.flight)
        gate = self._gate.passing()
        await gate.__aenter__()
        if self._begun.get(flight) != begun:
            await gate.__aexit__(None, None, None)
            raise StoppedError("the flight has begun anew elsewhere")
        place = self._places[flight] = _Place(gate)
        try:
            expected = await self._pace.turn(self._spending.seconds_left)
            if self._places.get(flight) is not place:
                raise StoppedError("the flight has begun anew elsewhere")
            self._check_going_on()
            self._spending.take_request()
        except BaseException:
            if self._places.get(flight) is place:
                await self._free(flight)
            raise
        place.sent_at, place.expected = self._clock.now(), expected
        return self._spending.seconds_left

    async def leave(self, key: CallKey, answered: bool, overloaded: bool = False, pause: float = 0.0) -> None:
        """See `Desk`."""
        place = self._places.get(key.flight)
        if place is None:
            return
        if overloaded:
            self._gate.overloaded(place.sent_at, min(pause, self._spending.seconds_left))
        if answered:
            self._gate.succeeded()
            self._expected[key.flight] = place.expected
        else:
            self._pace.unused(place.expected)
        await self._free(key.flight)

    async def record(self, call: Call, cache_key: str) -> Call:
        """See `Desk`. Of two answers to one call, from a process that was believed dead, the first counts."""
        first = self._transcript.answered.get(call.key)
        if first is not None:
            self._spending.add(call, counted=call.requests)
            return first
        call = self._transcript.append(call)
        self._spending.add(call, counted=call.requests)
        expected = self._expected.pop(call.flight, 0.0)
        if call.answer is not None and not call.cached:
            tokens = (call.answer.prompt_tokens or 0) + (call.answer.completion_tokens or 0)
            self._pace.used(tokens, expected)
        self._watcher.called(call)
        if call.answer is not None:
            self._any_answer = True
            if self._cache and not call.cached:
                self._cache.put(cache_key, call.answer)
        return call

    async def failed(self, status: int, reason: str, retried: bool, fatal: bool) -> None:
        """See `Desk`."""
        self._check_going_on()
        # What the very first call is refused for, such as a parameter that the model does not take, holds for all; and
        # so does where it is sent on to.
        if fatal or (not self._any_answer and 300 <= status < 500 and not retried):
            self.fatal = EndpointError(f"{self._host} answers {status}: {reason}")
        raise CallFailedError(f"{status or 'no answer'}: {reason}")

    def waiting(self, seconds: float, reason: str) -> None:
        """See `Desk`."""
        self._watcher.waiting(seconds, reason)

    def _check_going_on(self) -> None:
        if self.fatal is not None:
            raise StoppedError("the run is being stopped")

    async def _free(self, flight: int) -> None:
        place = self._places.pop(flight, None)
        if place is not None:
            await place.gate.__aexit__(None, None, None)
