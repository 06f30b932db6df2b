"""A run of a language model in a data folder, made in this process: a scripted pilot answers, no endpoint is asked."""

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path

from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import get_task, own_rules
from drone_env.files import RUNS
from drone_env.llm.answers import Answer, Reading, read_answer
from drone_env.llm.config import RunConfig, Sampling, digest, request_bodies
from drone_env.llm.content import ChatMessage
from drone_env.llm.flight import PilotedEpisode, fly
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import TRANSCRIPT, RunFolder
from drone_env.llm.transcript import Call, CallKey, Transcript
from drone_env.results.store import Store
from tests.llm.scripted_server import reply


def run_config(prompt: str, task: str, seeds: range, model: str = "scripted", repeats: int = 1) -> RunConfig:
    return RunConfig(
        model=model,
        base_url="http://localhost:1/v1",
        task=get_task(task).id,
        task_version=get_task(task).version,
        rules=own_rules(get_task(task)),
        split="custom",
        seeds=(seeds.start, seeds.stop),
        repeats=repeats,
        reward_profile=ORIGINAL_PROFILE,
        prompt=get_prompt(prompt).id,
        prompt_digest=get_prompt(prompt).digest,
        history=0,
        answers="text",
        stream=False,
        sampling=Sampling(),
    )


def put_run(
    data: Path, name: str, pilot: str, seeds: range, task: str = "easy", model: str = "scripted", repeats: int = 1
) -> Path:
    """Fly a run and keep it as `drone-env infer` does: its folder, and its flights in the store.

    Args:
        data: The data folder.
        name: Of the run's folder.
        pilot: What answers, as in `scripted_server`; to its very first prompt it says "Hm." instead.
        seeds: The maps.
        task: The task.
        model: What the model is called.
        repeats: Flights over each map.
    """
    prompt = get_prompt("minimal")
    config = run_config(prompt.id, task, seeds, model, repeats)
    folder = RunFolder(data / RUNS / name, config, resume=False)
    # In a thread of its own, since a browser's test has an event loop in its own already.
    with ExitStack() as opened, ThreadPoolExecutor(1) as thread:
        opened.callback(folder.close)
        transcript = opened.enter_context(closing(Transcript(folder.path / TRANSCRIPT)))
        store = opened.enter_context(Store(data))

        async def ask(key: CallKey, messages: list[ChatMessage]) -> Reading:
            said = "Hm." if key == (0, 1, 1) else reply(pilot, messages[1]["content"])
            answer = Answer(text=said, finish_reason="stop", prompt_tokens=100, completion_tokens=2)
            reading = read_answer(answer, prompt.plan)
            seed, repeat = config.flight(key.flight)
            asked = digest({"body": request_bodies(config)[0], "messages": messages})
            told = {"outcome": reading.kind, "latency": 0.5, "at": time.time()}
            numbers = {"flight": key.flight, "turn": key.turn, "attempt": key.attempt, "seed": seed, "repeat": repeat}
            transcript.append(Call(**numbers, messages=messages, request_digest=asked, answer=answer, **told))
            return reading

        flights: list[PilotedEpisode] = []
        for flight in range(config.flights):
            seed, repeat = config.flight(flight)
            flown = PilotedEpisode(flight, repeat, Episode(config.task_config, config.profile, seed))
            flights.append(thread.submit(asyncio.run, fly(flown, prompt, 0, ask)).result())
            folder.keep(flights[-1], store)
        folder.write_flights(flights)
    return folder.path
