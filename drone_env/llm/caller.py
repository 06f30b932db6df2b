"""Brings the answer of one call: from the transcript, the cache, or the endpoint with retries, within the limits."""

import time
from dataclasses import dataclass

from tenacity import AsyncRetrying, RetryCallState, stop_after_attempt
from tenacity.retry import retry_if_exception
from tenacity.stop import stop_base
from tenacity.wait import wait_random_exponential

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.clock import Clock
from drone_env.llm.config import RunConfig, digest
from drone_env.llm.desk import Desk
from drone_env.llm.endpoint import Endpoint, TryFailedError
from drone_env.llm.limits import LimitReachedError
from drone_env.llm.prompt import ChatMessage
from drone_env.llm.transcript import Call, CallKey, Failure

LONGEST_BACKOFF = 30.0


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
    """Makes the calls of flights, through the desk of their run.

    Args:
        config: The run.
        plan: Whether whole routes are asked for.
        endpoint: Where requests are sent.
        desk: The desk of the run.
        policy: How often a call is tried.
        clock: Tells the time, and waits between tries.
    """

    def __init__(
        self,
        config: RunConfig,
        plan: bool,
        endpoint: Endpoint,
        desk: Desk,
        policy: RetryPolicy,
        clock: Clock | None = None,
    ) -> None:
        self._config = config
        self._plan = plan
        self._endpoint = endpoint
        self._desk = desk
        self._policy = policy
        self._clock = clock or Clock()
        self._ends = float("inf")

    async def ask(self, key: CallKey, messages: list[ChatMessage]) -> Answer:
        """The answer of a call.

        Raises:
            CallFailedError: if none came after all retries.
            LimitReachedError: if the run may spend no more.
            StoppedError: if the run is being stopped for the sake of another call.
            InvalidValueError: if the transcript holds another request under this key.
        """
        request = digest({"body": self._endpoint.body, "messages": messages})
        seed, repeat = self._config.flight(key.flight)
        # A repeat is another draw from the model, and so is a repair: only equal ones share an answer.
        cache_key = digest([self._config.base_url, request, repeat, key.attempt])
        answer, cached = await self._desk.known(key, request, cache_key)
        if answer is not None and not cached:
            return answer
        failures: list[Failure] = []
        started = self._clock.now()
        failed: TryFailedError | LimitReachedError | None = None
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
            latency=0.0 if cached else self._clock.now() - started,
            at=time.time(),
            cached=cached,
        )
        if answer is not None or failures:
            call = await self._desk.record(call, cache_key)
        if isinstance(failed, LimitReachedError):
            raise failed
        if failed is not None:
            await self._desk.failed(failed.status, failed.reason, failed.retried, failed.fatal)
        if call.answer is None:
            raise AssertionError("a call without an answer has failed")
        return call.answer

    async def _try(self, key: CallKey, messages: list[ChatMessage], failures: list[Failure]) -> tuple[Answer, float]:
        """The answer and when its request was sent; all failed tries are noted in `failures`."""
        backoff = wait_random_exponential(multiplier=self._policy.backoff, max=LONGEST_BACKOFF)

        def wait(state: RetryCallState) -> float:
            asked = _failure(state).retry_after
            # Behind the end of the run's time nothing is sent: there is nothing to wait for.
            return min(backoff(state) if asked is None else asked, max(0.0, self._ends - self._clock.now()))

        def note(state: RetryCallState) -> None:
            failed, waited = _failure(state), state.next_action.sleep if state.next_action else 0.0
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=waited))
            self._desk.waiting(waited, str(failed))

        retrying = AsyncRetrying(
            retry=retry_if_exception(lambda error: isinstance(error, TryFailedError) and error.retried),
            stop=stop_after_attempt(self._policy.tries) | _AsksTooMuch(self._policy.longest_wait),
            wait=wait,
            before_sleep=note,
            sleep=self._clock.sleep,
            reraise=True,
        )
        try:
            return await retrying(self._send, key, messages)
        except TryFailedError as failed:
            failures.append(Failure(status=failed.status, reason=failed.reason, waited=0.0))
            raise

    async def _send(self, key: CallKey, messages: list[ChatMessage]) -> tuple[Answer, float]:
        self._ends = await self._desk.enter(key) + self._clock.now()
        sent_at = self._clock.now()
        try:
            answer = await self._endpoint.ask(messages, str(key))
        except TryFailedError as failed:
            pause = min(failed.retry_after or 0.0, self._policy.longest_wait)
            await self._desk.leave(key, answered=False, overloaded=failed.retried, pause=pause)
            raise
        except BaseException:
            await self._desk.leave(key, answered=False)
            raise
        await self._desk.leave(key, answered=True)
        return answer, sent_at


def _failure(state: RetryCallState) -> TryFailedError:
    error = state.outcome.exception() if state.outcome else None
    if not isinstance(error, TryFailedError):
        raise AssertionError(f"only failed tries are retried, not {error!r}")
    return error
