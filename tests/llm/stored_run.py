"""Runs of a language model in this process and in virtual time: their waits take none."""

import asyncio
import dataclasses
import itertools
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from drone_env.core.tasks import custom_task_rules, get_task
from drone_env.files import RUNS
from drone_env.flights.store import Store
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, Options
from drone_env.llm.config import RunConfig, Sampling
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import Run, locked_run
from drone_env.llm.runner import Runner
from drone_env.llm.sender import TryFailedError
from drone_env.llm.transcript import Call, read_calls
from tests.llm.scripted_server import reply

T = TypeVar("T")
BEGAN = 1000.0
"""The virtual time at which runs begin."""


class VirtualLoop(asyncio.SelectorEventLoop):
    """Sets its clock forward instead of waiting for the next timer."""

    def __init__(self) -> None:
        self._now = BEGAN
        super().__init__()
        selector: Any = self.__dict__["_selector"]
        select = selector.select

        def skip(timeout: float | None) -> Any:
            assert timeout is not None, "everything waits for something that will not happen"
            self._now += timeout
            return select(0)

        selector.select = skip

    def time(self) -> float:
        return self._now


def in_virtual_time(work: Coroutine[Any, Any, T]) -> tuple[T, float]:
    """The result of a coroutine, and the seconds that it took; what it leaves running is cancelled."""
    loop = VirtualLoop()
    try:
        return loop.run_until_complete(work), loop.time() - BEGAN
    finally:
        for task in asyncio.all_tasks(loop):
            task.cancel()
            loop.run_until_complete(asyncio.wait([task]))
        loop.close()


class Scripted:
    """Answers as a pilot of `scripted_server` without a server; to the very first prompt it says "Hm." instead.

    Args:
        pilot: The pilot, or a function that returns it for a request by its number from 0.
        fails: Returns the failure of a request by its number; None to answer it.

    Attributes:
        requests: Number of requests.
    """

    def __init__(
        self,
        pilot: str | Callable[[int], str] = "greedy",
        fails: Callable[[int], TryFailedError | None] = lambda _: None,
    ) -> None:
        self._pilot, self._fails = pilot, fails
        self.requests = 0

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        number, self.requests = self.requests, self.requests + 1
        if (failure := self._fails(number)) is not None:
            raise failure
        pilot = self._pilot if isinstance(self._pilot, str) else self._pilot(number)
        said = "Hm." if call_id == "0-1-1" else reply(pilot, request["messages"][1]["content"])
        return Answer(text=said, finish_reason="stop", prompt_tokens=100, completion_tokens=2)

    async def close(self) -> None: ...


def run_config(
    prompt: str = "minimal", task: str = "easy", seeds: Sequence[int] = (14, 15), **change: Any
) -> RunConfig:
    """A run, by default over map 14 of easy, which takes a greedy pilot 3 steps."""
    known, chosen = get_task(task), get_prompt(prompt)
    fields: dict[str, Any] = {
        "model": "scripted",
        "base_url": "http://localhost:1/v1",
        "task": known.id,
        "task_version": known.version,
        "rules": custom_task_rules(known),
        "split": "custom",
        "seeds": (seeds[0], seeds[-1] + 1) if isinstance(seeds, range) else seeds,
        "repeats": 1,
        "prompt": chosen.id,
        "prompt_digest": chosen.digest,
        "answers": "text",
        "sampling": Sampling(),
    }
    return RunConfig.model_validate(fields | change)


@dataclasses.dataclass
class Flown:
    """The result of a run, its calls, and its virtual seconds."""

    result: Run
    calls: list[Call]
    seconds: float

    @property
    def turns(self) -> list[str]:
        """The outcomes of all requests for actions."""
        return list(itertools.chain.from_iterable(flight.turns for flight in self.result.flights))

    @property
    def waits(self) -> list[float]:
        """The seconds waited after each failed try."""
        return [failure.waited for call in self.calls for failure in call.failures]


def fly(sender: Any, folder: Path, options: Options | None = None, store: Store | None = None, **change: Any) -> Flown:
    """Fly a run, by default one request at a time; a run in the folder goes on."""
    config, budget = run_config(**change), Budget(options or Options(concurrency=1))
    with locked_run(folder, config, resume=folder.exists()):
        result, seconds = in_virtual_time(Runner(config, folder, sender, budget, store).fly())
    return Flown(result, list(read_calls(folder / "calls.jsonl")), seconds)


def put_run(data: Path, name: str, pilot: str, seeds: range, **change: Any) -> Path:
    """Fly a run by a pilot of `Scripted`, and store its flights as `drone-env infer` does; its folder."""
    folder = data / RUNS / name
    # In a thread of its own, since the event loop of a browser's test runs in this one.
    with ThreadPoolExecutor(1) as thread, Store(data) as store:
        thread.submit(fly, Scripted(pilot), folder, store=store, seeds=seeds, **change).result()
    return folder
