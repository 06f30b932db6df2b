"""Runs against simulated servers, in virtual time: their waits take none."""

import asyncio
import random
from collections import Counter
from collections.abc import Coroutine, Mapping
from pathlib import Path
from typing import Any, TypeVar

from drone_env.llm.answers import Answer
from drone_env.llm.budget import Options
from drone_env.llm.endpoint import TryFailedError
from drone_env.llm.limiter import RateLimiter
from drone_env.llm.progress import Progress
from drone_env.llm.run_folder import CONFIG, locked_run
from drone_env.llm.runner import RunResult, run

from .stored_run import Scripted, run_config

T = TypeVar("T")
BEGAN = 1000.0


class VirtualLoop(asyncio.SelectorEventLoop):
    """Sets its clock forward instead of waiting for the next timer."""

    def __init__(self) -> None:
        super().__init__()
        self._now = BEGAN
        selector: Any = self.__dict__["_selector"]
        select = selector.select

        def skip(timeout: float | None) -> Any:
            assert timeout is not None, "everything waits for something that will not happen"
            self._now += timeout
            return select(0)

        selector.select = skip

    def time(self) -> float:
        return self._now


def in_virtual_time(work: Coroutine[Any, Any, T]) -> T:
    """The result of a coroutine; what it leaves running is cancelled."""
    loop = VirtualLoop()
    try:
        return loop.run_until_complete(work)
    finally:
        for task in asyncio.all_tasks(loop):
            task.cancel()
            loop.run_until_complete(asyncio.wait([task]))
        loop.close()


class Server(Scripted):
    """Answers as a greedy pilot. It does not notice that a client is gone, and works on.

    Args:
        batch: Number of requests that it answers at once; others wait.
        seconds: Time for an answer of 100 tokens.
        varying: Whether answers have 20 to 500 tokens.
        loading: Seconds that the first answer takes longer.
        refuses_above: Number of requests at once, above which it refuses.
        fails: Share of requests that fail for no reason.
        timeout: The client's.

    Attributes:
        requests, answers: Their numbers.
        most_open: The most requests that it had at once.
        most_of_a_call: The most requests of one call that it had at once.
        open_seconds: The seconds that clients waited for answers, of all together.
        worked: The seconds that all answers took alone.
    """

    def __init__(
        self,
        batch: int,
        seconds: float = 1.0,
        *,
        varying: bool = False,
        loading: float = 0.0,
        refuses_above: int = 10**9,
        fails: float = 0.0,
        timeout: float = 120.0,
    ) -> None:
        super().__init__("greedy")
        self._seconds, self._varying, self._loading = seconds, varying, loading
        self._refuses_above, self._fails, self._timeout = refuses_above, fails, timeout
        self._random = random.Random(1)
        self._places = asyncio.Semaphore(batch)
        self._open: Counter[str] = Counter()
        self.requests = self.answers = self.most_open = self.most_of_a_call = 0
        self.open_seconds = self.worked = 0.0

    async def _work(self, call_id: str, tokens: int) -> None:
        async with self._places:
            loading, self._loading = self._loading, 0.0
            await asyncio.sleep(loading + self._seconds * tokens / 100)
        self._open[call_id] -= 1

    async def tokens(self, call_id: str) -> int:
        """Work on a request; the tokens of its answer."""
        self.requests += 1
        if self._open.total() >= self._refuses_above:
            raise TryFailedError(429, "too many", retried=True)
        if self._random.random() < self._fails:
            raise TryFailedError(500, "bad luck", retried=True)
        tokens = self._random.choice([20, 50, 100, 100, 500]) if self._varying else 100
        self._open[call_id] += 1
        self.most_open = max(self.most_open, self._open.total())
        self.most_of_a_call = max(self.most_of_a_call, self._open[call_id])
        loop = asyncio.get_running_loop()
        began = loop.time()
        try:
            work = asyncio.ensure_future(self._work(call_id, tokens))
            await asyncio.wait_for(asyncio.shield(work), self._timeout)
        except asyncio.TimeoutError:
            raise TryFailedError(0, "no answer", retried=True, timed_out=True) from None
        finally:
            self.open_seconds += loop.time() - began
        self.answers += 1
        self.worked += self._seconds * tokens / 100
        return tokens

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        tokens = await self.tokens(call_id)
        return (await super().send(request, call_id)).model_copy(update={"completion_tokens": tokens})


def simulate(server: Server, folder: Path, options: Options | None = None, **change: Any) -> RunResult:
    """Fly a run against a server."""

    async def flown() -> RunResult:
        config = run_config(**change)
        limiter = RateLimiter(options or Options(), asyncio.get_running_loop().time)
        progress = Progress(config, limiter.budget, folder)
        with locked_run(folder, config, resume=(folder / CONFIG).exists()):
            return await run(config, folder, server, limiter, progress)

    return in_virtual_time(flown())
