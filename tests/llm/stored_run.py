"""Runs of a language model made in this process: with a clock that only waiting moves, or a scripted model."""

import asyncio
import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from drone_env.core.tasks import get_task, own_rules
from drone_env.files import RUNS
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Options
from drone_env.llm.config import RunConfig, Sampling
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.limiter import RateLimiter
from drone_env.llm.progress import Progress
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import locked_run
from drone_env.llm.runner import RunResult, run
from drone_env.llm.transcript import Call, read_calls
from drone_env.results.store import Store
from tests.llm.scripted_server import reply


class VirtualClock:
    """Stands still but for waits, which are over at once and noted."""

    def __init__(self) -> None:
        self.began = self.time = 1000.0
        self.slept: list[float] = []

    @property
    def passed(self) -> float:
        """Seconds since it was made."""
        return self.time - self.began

    def now(self) -> float:
        return self.time

    async def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.time += seconds
        await asyncio.sleep(0)


class Scripted:
    """Answers as a pilot of `scripted_server` without a server; to the very first prompt it says "Hm." instead."""

    def __init__(self, pilot: str) -> None:
        self._pilot = pilot

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        said = "Hm." if call_id == "0-1-1" else reply(self._pilot, request["messages"][1]["content"])
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
        "rules": own_rules(known),
        "split": "custom",
        "seeds": (seeds[0], seeds[-1] + 1) if isinstance(seeds, range) else seeds,
        "repeats": 1,
        "reward_profile": "tiered",
        "prompt": chosen.id,
        "prompt_digest": chosen.digest,
        "history": 0,
        "answers": "text",
        "sampling": Sampling(),
    }
    return RunConfig.model_validate(fields | change)


@dataclasses.dataclass
class Flown:
    """The result of a run in virtual time."""

    result: RunResult
    clock: VirtualClock
    calls: list[Call]

    @property
    def turns(self) -> list[str]:
        """The outcomes of all requests for actions."""
        return [turn for flight in self.result.flights for turn in flight.turns]


def fly(
    at: str | Scripted, folder: Path, options: Options | None = None, store: Store | None = None, **change: Any
) -> Flown:
    """Fly a run whose waits take no time: against an endpoint or a scripted model, one request at a time by default."""
    options = options or Options(concurrency=1)
    config = run_config(**change, **({"base_url": at} if isinstance(at, str) else {}))
    clock = VirtualClock()
    sender = Endpoint(at, None, options.timeout) if isinstance(at, str) else at
    limiter = RateLimiter(options, clock.now, clock.sleep)
    progress = Progress(config, limiter.budget, folder, store=store)
    with locked_run(folder, config, resume=False):
        result = asyncio.run(run(config, folder, sender, limiter, progress))
    return Flown(result, clock, list(read_calls(folder / "calls.jsonl")))


def put_run(data: Path, name: str, pilot: str, seeds: range, **change: Any) -> Path:
    """Fly a run by a pilot of `Scripted`, and store its flights as `drone-env infer` does; its folder."""
    folder = data / RUNS / name
    # In a thread of its own, since the event loop of a browser's test runs in this one.
    with ThreadPoolExecutor(1) as thread, Store(data) as store:
        thread.submit(fly, Scripted(pilot), folder, store=store, seeds=seeds, **change).result()
    return folder
