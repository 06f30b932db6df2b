"""The drone as a task of Inspect (https://inspect.aisi.org.uk): `inspect eval drone_env/drone_delivery --model ...`.

Prompts, answers and flights are those of `drone-env infer`, so the scores are the same. Inspect handles failures and
limits: a failed call makes its sample an error, which is not in the mean.
"""

# Inspect is in no environment in which types are checked: its requirements fit no others.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownParameterType=false
# pyright: reportUntypedFunctionDecorator=false

import math
from typing import Any

from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import needs
from drone_env.flights.record import record_of
from drone_env.llm.answers import Answer, ChatMessage, Unusable
from drone_env.llm.prompt import get_prompt
from drone_env.llm.run_folder import MAX_ERRORED, turns_of
from drone_env.llm.text_episode import EpisodeRun, TextEpisode

with needs("inspect"):
    import anyio
    from inspect_ai import Task, task  # pyright: ignore[reportMissingImports]
    from inspect_ai.dataset import MemoryDataset, Sample  # pyright: ignore[reportMissingImports]
    from inspect_ai.model import (  # pyright: ignore[reportMissingImports]
        ChatMessageAssistant,
        ChatMessageSystem,
        ChatMessageUser,
        GenerateConfig,
        get_model,
    )
    from inspect_ai.scorer import Score, Scorer, Target, mean, scorer, stderr  # pyright: ignore[reportMissingImports]
    from inspect_ai.solver import Generate, Solver, TaskState, solver  # pyright: ignore[reportMissingImports]
    from inspect_ai.util import LimitExceededError  # pyright: ignore[reportMissingImports]

ROLES = {"system": ChatMessageSystem, "user": ChatMessageUser, "assistant": ChatMessageAssistant}


@task
def drone_delivery(
    task: str = "easy",
    prompt: str = "minimal",
    episodes: int = 100,
    split: str = "test",
    sampling_seed: int | None = None,
) -> Task:
    """Flights over the first maps of a split, one sample a map; Inspect's epochs are repeats.

    Args:
        task: The task: id, short name or grader.
        prompt: The prompt: name (the newest version), id, or your own file.
        episodes: Number of maps.
        split: Split of the maps: train, validation or test.
        sampling_seed: Seed of the first epoch; each further epoch sends the next one. Inspect's own `--seed` is the
            same in every epoch, so that all epochs are equal.

    Raises:
        UnknownNameError: if the task, prompt or split does not exist.
        InvalidValueError: if `episodes` is out of range.
    """
    config, chosen = get_task(task), get_prompt(prompt)
    samples: list[Sample] = []
    for seed in split_seeds(split, episodes):
        messages = TextEpisode(config, seed, chosen).messages
        samples.append(Sample(id=str(seed), input=_inspect_messages(messages), metadata={"seed": seed}))
    return Task(
        dataset=MemoryDataset(samples, name=f"{config.id}-{split}"),
        solver=pilot(config.id, prompt if chosen.own else chosen.id, sampling_seed),
        scorer=graded(),
        fail_on_error=MAX_ERRORED,
        name=config.id,
        version=config.version,
        metadata={"prompt": chosen.id, "prompt_digest": chosen.digest},
    )


@solver
def pilot(task: str, prompt: str, sampling_seed: int | None = None) -> Solver:
    """Fly the map of a sample to its end.

    Args:
        task: Id of the task.
        prompt: Id of the prompt, or its file.
        sampling_seed: Seed of the first epoch.
    """
    config, chosen = get_task(task), get_prompt(prompt)

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        model = get_model()
        sampling = GenerateConfig(seed=None if sampling_seed is None else sampling_seed + state.epoch - 1)
        seed = state.metadata["seed"]
        flight = EpisodeRun(config, seed, chosen)
        flight.repeat = state.epoch - 1
        while flight.messages:
            messages = _inspect_messages(flight.messages)
            try:
                output = await model.generate(messages, config=sampling)
            except (LimitExceededError, anyio.get_cancelled_exc_class()) as error:
                # Inspect records the limit and scores the steps so far.
                flight.stop("budget_stop", str(error) or "stopped by Inspect")
                state.store.set("flight", _stored(flight, str(state.model)))
                raise
            state.messages, state.output = [*messages, output.message], output
            flight.answer(Answer(text=output.completion, finish_reason=output.stop_reason))
        state.store.set("flight", _stored(flight, str(state.model)))
        state.completed = True
        return state

    return solve


@scorer(metrics={name: [mean(), stderr()] for name in ("score", "unusable", "success", "regret")})
def graded() -> Scorer:
    """The graded score of a flight, the share of unusable answers, success (all delivered), and regret.

    An unfinished flight counts as waiting to its end. Regret is NaN (unscored) if the map is too large to be solved,
    and the share is NaN without any answer. The metadata contain the outcomes of all answers and the flight's record.
    """

    async def score(state: TaskState, target: Target) -> Score:
        stored: dict[str, Any] = state.store.get("flight")
        return Score(
            value={name: math.nan if value is None else float(value) for name, value in stored["value"].items()},
            answer=" ".join(stored["actions"]),
            explanation=stored["log"],
            metadata={name: stored[name] for name in ("status", "turns", "record")},
        )

    return score


def _stored(flight: EpisodeRun, agent: str) -> dict[str, Any]:
    """A flight as JSON values, which a sample can store."""
    turns = turns_of([flight])
    unusable = Unusable.among(turns).share
    value = {"score": flight.score, "unusable": unusable, "success": flight.success, "regret": flight.regret}
    return {
        "value": value,
        "status": flight.status,
        "turns": turns,
        "record": record_of(flight.episode, agent).to_json(),
        "actions": [step.action.name for step in flight.episode.path],
        "log": "\n".join([*flight.log_lines(agent), flight.last_line]),
    }


def _inspect_messages(
    messages: list[ChatMessage],
) -> list[ChatMessageSystem | ChatMessageUser | ChatMessageAssistant]:
    return [ROLES[message["role"]](content=message["content"]) for message in messages]
