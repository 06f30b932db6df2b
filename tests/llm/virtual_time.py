"""Runs whose waits take no time: a clock that only waiting moves, and a run by it against a real endpoint."""

import asyncio
import dataclasses
from pathlib import Path
from typing import Any

from drone_env.llm.config import RunConfig, Sampling
from drone_env.llm.endpoint import Endpoint
from drone_env.llm.flight import PilotedEpisode
from drone_env.llm.limiter import Clock, RateLimiter
from drone_env.llm.options import Options
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import RunFolder
from drone_env.llm.runner import RunResult, run
from drone_env.llm.transcript import Call, read_calls


class VirtualClock(Clock):
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


class Nobody:
    """Watches nothing."""

    def called(self, call: Call) -> None: ...

    def waiting(self, seconds: float, reason: str) -> None: ...

    def flown(self, flown: PilotedEpisode) -> None: ...


def run_config(**change: Any) -> RunConfig:
    """A run over map 14 of easy, which takes a greedy pilot 3 steps."""
    fields: dict[str, Any] = {
        "model": "m",
        "base_url": "https://x/v1",
        "task": "easy_delivery",
        "task_version": 1,
        "split": "custom",
        "seeds": (14, 15),
        "repeats": 1,
        "reward_profile": "tiered",
        "prompt": "minimal-2",
        "prompt_digest": get_prompt("minimal").digest,
        "history": 0,
        "answers": "text",
        "stream": False,
        "sampling": Sampling(),
    }
    return RunConfig.model_validate(fields | change)


@dataclasses.dataclass
class Flown:
    """What a run in virtual time came to."""

    result: RunResult
    clock: VirtualClock
    calls: list[Call]

    @property
    def turns(self) -> list[str]:
        """How all requests for actions came out."""
        return [turn for flight in self.result.flights for turn in flight.turns]


def fly(url: str, folder: Path, options: Options, **change: Any) -> Flown:
    """Fly a run, one request at a time, whose waits take no time."""
    config, clock = run_config(base_url=url, **change), VirtualClock()
    options = dataclasses.replace(options, concurrency=1)
    opened = RunFolder(folder, config, resume=False)
    try:
        endpoint = Endpoint(config, None, options.timeout)
        result = asyncio.run(run(config, opened, endpoint, RateLimiter(options, clock), Nobody()))
    finally:
        opened.close()
    return Flown(result, clock, [call for _, call in read_calls(folder / "calls.jsonl")])
