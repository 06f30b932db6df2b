"""Brings the answer of one call: from the transcript, the cache, or the endpoint with retries, within the limits."""

import time
from dataclasses import dataclass
from typing import Protocol

from tenacity import AsyncRetrying, RetryCallState, stop_after_attempt
from tenacity.retry import retry_if_exception
from tenacity.stop import stop_base
from tenacity.wait import wait_random_exponential

from drone_env.errors import DroneEnvError, EndpointError, InvalidValueError
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.cache import AnswerCache
from drone_env.llm.concurrency import AdaptiveGate
from drone_env.llm.config import RunConfig, digest
from drone_env.llm.endpoint import Endpoint, TryFailedError
from drone_env.llm.limits import LimitReachedError, Spending
from drone_env.llm.pilot import CallFailedError
from drone_env.llm.prompt import ChatMessage
from drone_env.llm.transcript import Call, CallKey, Failure, Transcript

LONGEST_BACKOFF = 30.0


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


@dataclass(frozen=True)
class RetryPolicy:
    """How often a call is tried.

    Attributes:
        tries: At most so often.
        backoff: Seconds: the first wait is random below this, and the bound doubles each time, up to 30 s.
        longest_wait: Seconds: an endpoint that asks for a longer wait is not waited for.
    """

    tries: int = 6
    backoff: float = 1.0
    longest_wait: float = 120.0

    def __post_init__(self) -> None:
        if not 1 <= self.tries <= 100 or not self.backoff >= 0 or not self.longest_wait >= 0:
            raise InvalidValueError("tries must be 1 to 100; backoff and the longest wait 0 s or more")


class _AsksTooMuch(stop_base):
    """Stops where the endpoint asks for a longer wait than allowed."""

    def __init__(self, longest: float) -> None:
        self._longest = longest

    def __call__(self, retry_state: RetryCallState) -> bool:
        return (_failure(retry_state).retry_after or 0) > self._longest


class Caller:
    """Makes the calls of a run.

    Attributes:
        fatal: Why no further call makes sense; None while they do.
    """

    def __init__(
        self,
        config: RunConfig,
        plan: bool,
        endpoint: Endpoint,
        transcript: Transcript,
        spending: Spending,
        gate: AdaptiveGate,
        policy: RetryPolicy,
        cache: AnswerCache | None,
        watcher: Watcher,
    ) -> None:
        self.fatal: EndpointError | None = None
        self._config = config
        self._plan = plan
        self._endpoint = endpoint
        self._transcript = transcript
        self._spending = spending
        self._gate = gate
        self._policy = policy
        self._cache = cache
        self._watcher = watcher
        self._any_answer = any(call.answer is not None for call in transcript.calls)

    async def ask(self, key: CallKey, messages: list[ChatMessage]) -> Answer:
        """The answer of a call.

        Raises:
            CallFailedError: if none came after all retries, or `fatal` says why none can come.
            LimitReachedError: if the run may spend no more.
            StoppedError: if the run is being stopped for the sake of another call.
            InvalidValueError: if the transcript holds another request under this key.
        """
        request = digest({"body": self._endpoint.body, "messages": messages})
        known = self._transcript.answered.get(key)
        if known is not None and known.answer is not None:
            if known.request_digest != request:
                raise InvalidValueError(f"{self._transcript.path}: call {key} asks something else than this run would")
            return known.answer
        if self.fatal is not None:
            raise StoppedError("the run is being stopped")
        seed, repeat = self._config.flight(key.flight)
        # A repeat is another draw from the model, and so is a repair: only equal ones share an answer.
        cache_key = digest([self._config.base_url, request, repeat, key.attempt])
        cached = self._cache.get(cache_key) if self._cache else None
        failures: list[Failure] = []
        started = time.monotonic()
        answer, failed = cached, None
        if answer is None:
            try:
                answer, started = await self._try(key, messages, failures)
            except (TryFailedError, LimitReachedError) as error:
                failed = error
        outcome = "budget_stop" if isinstance(failed, LimitReachedError) else "api_error"
        call = Call(
            flight=key.flight,
            seed=seed,
            repeat=repeat,
            turn=key.turn,
            attempt=1 if key.attempt == 1 else 2,
            messages=messages,
            request_digest=request,
            answer=answer,
            outcome=outcome if answer is None else read_answer(answer, self._plan).kind,
            failures=failures,
            latency=0.0 if cached else time.monotonic() - started,
            at=time.time(),
            cached=cached is not None,
        )
        if answer is not None or failures:
            call = self._transcript.append(call)
            self._spending.add(call, counted=call.requests)
            self._watcher.called(call)
        if failed is not None:
            self._fail(failed)
        if call.answer is None:
            raise AssertionError("a call without an answer has failed")
        self._any_answer = True
        if self._cache and cached is None:
            self._cache.put(cache_key, call.answer)
        return call.answer

    def _fail(self, failed: TryFailedError | LimitReachedError) -> None:
        if isinstance(failed, LimitReachedError):
            raise failed
        if self.fatal is not None:
            raise StoppedError("the run is being stopped")
        # What the very first call is refused for, such as a parameter that the model does not take, holds for all.
        if failed.fatal or (not self._any_answer and 400 <= failed.status < 500 and not failed.retried):
            self.fatal = EndpointError(f"{self._endpoint.host} answers {failed.status}: {failed.reason}")
        raise CallFailedError(str(failed))

    async def _try(self, key: CallKey, messages: list[ChatMessage], failures: list[Failure]) -> tuple[Answer, float]:
        """The answer and when its request was sent; all failed tries are noted in `failures`."""
        backoff = wait_random_exponential(multiplier=self._policy.backoff, max=LONGEST_BACKOFF)

        def wait(state: RetryCallState) -> float:
            asked = _failure(state).retry_after
            # Behind the end of the run's time nothing is sent: there is nothing to wait for.
            return min(backoff(state) if asked is None else asked, self._spending.seconds_left)

        def note(state: RetryCallState) -> None:
            failed, waited = _failure(state), state.next_action.sleep if state.next_action else 0.0
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=waited))
            self._watcher.waiting(waited, str(failed))

        retrying = AsyncRetrying(
            retry=retry_if_exception(lambda error: isinstance(error, TryFailedError) and error.retried),
            stop=stop_after_attempt(self._policy.tries) | _AsksTooMuch(self._policy.longest_wait),
            wait=wait,
            before_sleep=note,
            reraise=True,
        )
        try:
            return await retrying(self._send, key, messages)
        except TryFailedError as failed:
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=0.0))
            raise

    async def _send(self, key: CallKey, messages: list[ChatMessage]) -> tuple[Answer, float]:
        async with self._gate.passing():
            if self.fatal is not None:
                raise StoppedError("the run is being stopped")
            self._spending.take_request()
            sent_at = time.monotonic()
            try:
                answer = await self._endpoint.ask(messages, str(key))
            except TryFailedError as failed:
                if failed.retried:
                    pause = min(failed.retry_after or 0.0, self._policy.longest_wait, self._spending.seconds_left)
                    self._gate.overloaded(sent_at, pause)
                raise
            self._gate.succeeded()
            return answer, sent_at


def _failure(state: RetryCallState) -> TryFailedError:
    error = state.outcome.exception() if state.outcome else None
    if not isinstance(error, TryFailedError):
        raise AssertionError(f"only failed tries are retried, not {error!r}")
    return error
