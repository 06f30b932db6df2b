"""Brings the answer of one call: from the transcript, the cache, or the endpoint with retries, within the limits."""

import random
import time

from drone_env.llm.answers import Answer, Reading, read_answer
from drone_env.llm.config import RunConfig, digest
from drone_env.llm.desk import Desk
from drone_env.llm.endpoint import Endpoint, TryFailedError
from drone_env.llm.gate import Clock, LimitReachedError
from drone_env.llm.messages import ChatMessage, with_pictures
from drone_env.llm.options import Options
from drone_env.llm.transcript import Call, CallKey, Failure

LONGEST_BACKOFF = 30.0


class Caller:
    """Makes the calls of flights, through the desk of their run.

    Args:
        config: The run.
        endpoint: Where requests are sent.
        desk: The desk of the run.
        options: How often a call is tried, and how long is waited.
        clock: Gives the time, and waits between tries.
    """

    def __init__(
        self, config: RunConfig, endpoint: Endpoint, desk: Desk, options: Options, clock: Clock | None = None
    ) -> None:
        self._config = config
        self._prompt = config.load_prompt()
        self._endpoint = endpoint
        self._desk = desk
        self._options = options
        self._clock = clock or Clock()

    async def ask(self, key: CallKey, messages: list[ChatMessage]) -> Reading:
        """The answer of a call, as it was understood.

        Raises:
            CallFailedError: if none came after all retries.
            LimitReachedError: if the run may spend no more.
            StoppedError: if the run is being stopped for the sake of another call.
            InvalidValueError: if the transcript holds another request under this key.
        """
        seed, repeat = self._config.flight(key.flight)
        body = self._endpoint.bodies[repeat]
        request = digest({"body": body, "messages": messages})
        # A repeat is another draw from the model, and so is a repair: only equal ones share an answer.
        cache_key = digest([self._config.base_url, request, repeat, key.attempt])
        answer, cached = await self._desk.known(key, request, cache_key)
        if answer is not None and not cached:
            return self._read(answer, seed)
        failures: list[Failure] = []
        picture: str | None = None
        began = self._clock.now()

        async def record(answer: Answer | None, outcome: str) -> Answer | None:
            call = Call(
                flight=key.flight,
                seed=seed,
                repeat=repeat,
                turn=key.turn,
                attempt=1 if key.attempt == 1 else 2,
                messages=messages,
                picture=picture,
                request_digest=request,
                sampling_seed=body.get("seed"),
                answer=answer,
                outcome=outcome,
                failures=failures,
                latency=0.0 if cached else self._clock.now() - began,
                at=time.time(),
                cached=cached,
            )
            return await self._desk.record(call, cache_key)

        if answer is None:
            sent, picture = with_pictures(messages)
            try:
                answer, began = await self._try(key, sent, failures)
            except LimitReachedError:
                if failures:
                    await record(None, "budget_stop")
                raise
            except TryFailedError as failed:
                await record(None, "api_error")
                await self._desk.failed(failed.status, failed.reason, failed.retried, failed.fatal)
        reading = self._read(answer, seed)
        first = await record(answer, reading.kind)
        return reading if first is None else self._read(first, seed)

    def _read(self, answer: Answer, seed: int) -> Reading:
        prompt = self._prompt
        return read_answer(answer, prompt.plan, prompt.marks, prompt.symbols(self._config.task_config, seed).actions)

    async def _try(self, key: CallKey, messages: list[ChatMessage], failures: list[Failure]) -> tuple[Answer, float]:
        """The answer and when its request was sent; all failed tries are noted in `failures`."""
        options, (seed, repeat) = self._options, self._config.flight(key.flight)
        while True:
            ends = await self._desk.acquire(key.flight) + self._clock.now()
            sent_at = self._clock.now()
            try:
                answer = await self._endpoint.ask(messages, str(key), repeat)
            except TryFailedError as failed:
                asked = failed.retry_after
                pause = min(asked or 0.0, options.longest_wait)
                await self._desk.release(key.flight, None, overloaded=failed.retried, pause=pause)
                again = failed.retried and len(failures) + 1 < options.tries and (asked or 0.0) <= options.longest_wait
                bound = min(LONGEST_BACKOFF, options.backoff * 2 ** len(failures))
                wait = random.uniform(0, bound) if asked is None else asked
                # Behind the end of the run's time nothing is sent: there is nothing to wait for.
                wait = min(wait, max(0.0, ends - self._clock.now())) if again else 0.0
                failures.append(Failure(status=failed.status, reason=failed.reason, waited=wait))
                if not again:
                    raise
                attempt = f"attempt {len(failures)} of {options.tries} failed"
                await self._desk.waiting(wait, f"map {seed}, turn {key.turn}: {attempt}: {failed}")
                await self._clock.sleep(wait)
            except BaseException:
                await self._desk.release(key.flight, None)
                raise
            else:
                await self._desk.release(key.flight, (answer.prompt_tokens or 0) + (answer.completion_tokens or 0))
                return answer, sent_at
