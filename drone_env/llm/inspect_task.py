"""The drone as a task of Inspect (https://inspect.aisi.org.uk): `inspect eval drone_env/drone_delivery --model ...`.

A model is asked, read and flown by the same code as in `drone-env infer`, so the scores are the same. What fails or is
limited is Inspect's affair: a call that fails makes its sample an error, which is no part of the mean.
"""

# Inspect is in no environment in which types are checked: its requirements fit no others.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownParameterType=false
# pyright: reportUntypedFunctionDecorator=false

import math
from typing import Any

from drone_env.core.episode import Episode
from drone_env.core.rewards import DEFAULT_PROFILE
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError, needs
from drone_env.llm.answers import Answer, Reading, Unusable
from drone_env.llm.content import ChatMessage, with_pictures
from drone_env.llm.flight import PilotedEpisode, fly
from drone_env.llm.limiter import LimitReachedError
from drone_env.llm.prompt import first_messages, get_prompt
from drone_env.llm.run_folder import PilotedRecord
from drone_env.llm.runner import MOST_ERRORED, log_text
from drone_env.llm.transcript import CallKey
from drone_env.planning.optimal import best_of
from drone_env.results.record import record_of

with needs("inspect"):
    import anyio
    from inspect_ai import Task, task  # pyright: ignore[reportMissingImports]
    from inspect_ai.dataset import MemoryDataset, Sample  # pyright: ignore[reportMissingImports]
    from inspect_ai.model import (  # pyright: ignore[reportMissingImports]
        ChatMessageAssistant,
        ChatMessageSystem,
        ChatMessageUser,
        ContentImage,
        ContentReasoning,
        ContentText,
        GenerateConfig,
        ModelOutput,
        get_model,
    )
    from inspect_ai.scorer import Score, Scorer, Target, mean, scorer, stderr  # pyright: ignore[reportMissingImports]
    from inspect_ai.solver import Generate, Solver, TaskState, solver  # pyright: ignore[reportMissingImports]
    from inspect_ai.util import LimitExceededError  # pyright: ignore[reportMissingImports]

ROLES = {"system": ChatMessageSystem, "user": ChatMessageUser, "assistant": ChatMessageAssistant}
FINISH_REASONS = {"max_tokens": "length", "model_length": "length"}
"""Inspect's words for what OpenAI's protocol calls otherwise."""


@task
def drone_delivery(
    task: str = "easy",
    prompt: str = "minimal",
    episodes: int = 100,
    split: str = "test",
    history: int = 0,
    reward_profile: str = DEFAULT_PROFILE,
    sampling_seed: int | None = None,
) -> Task:
    """Flights over the first maps of a split, one sample a map; Inspect's epochs are repeats.

    Args:
        task: The task: id, short name or grader.
        prompt: The prompt, by its name (the newest version) or id, or a file of your own.
        episodes: How many maps.
        split: Whose maps: train, validation or test.
        history: How many of the last steps the prompt names.
        reward_profile: What steps pay; it changes no score.
        sampling_seed: The seed of the first epoch; each further one sends the next. Inspect's own `--seed` is the same
            in every epoch, so that these are copies.

    Raises:
        UnknownNameError: if the task, prompt, split or profile does not exist.
        InvalidValueError: if a number is out of range.
    """
    config, chosen = get_task(task), get_prompt(prompt)
    if history < 0:
        raise InvalidValueError(f"history must be 0 or more, got {history}")
    samples: list[Sample] = []
    for seed in split_seeds(split, episodes):
        messages = first_messages(chosen, Episode(config, reward_profile, seed))
        samples.append(Sample(id=str(seed), input=_inspects(messages), metadata={"seed": seed}))
    return Task(
        dataset=MemoryDataset(samples, name=f"{config.id}-{split}"),
        solver=pilot(config.id, prompt if chosen.own else chosen.id, history, reward_profile, sampling_seed),
        scorer=graded(),
        fail_on_error=MOST_ERRORED,
        name=config.id,
        version=config.version,
        metadata={"prompt": chosen.id, "prompt_digest": chosen.digest, "reward_profile": reward_profile},
    )


@solver
def pilot(task: str, prompt: str, history: int, reward_profile: str, sampling_seed: int | None = None) -> Solver:
    """Flies the map of a sample to its end; an unusable answer is asked for once more, then it is a WAIT.

    Args:
        task: Id of the task.
        prompt: Id of the prompt, or its file.
        history: How many of the last steps the prompt names.
        reward_profile: What steps pay.
        sampling_seed: The seed of the first epoch.
    """
    config, chosen = get_task(task), get_prompt(prompt)

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        model = get_model()
        stopped: BaseException | None = None
        sampling = GenerateConfig(seed=None if sampling_seed is None else sampling_seed + state.epoch - 1)

        async def ask(key: CallKey, messages: list[ChatMessage]) -> Reading:
            nonlocal stopped
            asked = _inspects(messages)
            try:
                output = await model.generate(asked, config=sampling)
            except (LimitExceededError, anyio.get_cancelled_exc_class()) as error:
                stopped = error
                raise LimitReachedError(str(error) or "stopped by Inspect") from error
            state.messages, state.output = [*asked, output.message], output
            return chosen.read_answer(_answer(output))

        flown = PilotedEpisode(0, state.epoch - 1, Episode(config, reward_profile, state.metadata["seed"]))
        await fly(flown, chosen, history, ask)
        state.store.set("flight", _stored(flown, str(state.model)))
        # Where a limit was reached, Inspect notes it and scores what was flown so far.
        if stopped is not None:
            raise stopped
        state.completed = True
        return state

    return solve


@scorer(metrics={name: [mean(), stderr()] for name in ("score", "unusable", "success", "regret")})
def graded() -> Scorer:
    """The graded score of a flight, the share of unusable answers, success, and the optimum of its map minus the score.

    An unfinished flight counts as if it waited to its end. Success is whether it delivered everything. NaN, which is
    unscored, are regret if a map is too large to be solved, and the share if no answer came. The metadata hold the
    outcomes of all answers and the record of the flight.
    """

    async def score(state: TaskState, target: Target) -> Score:
        kept: dict[str, Any] = state.store.get("flight")
        result = PilotedRecord.model_validate(kept["result"])
        optimum = best_of(get_task(kept["task"]), result.seed)
        regret = math.nan if optimum is None else optimum.score - result.score
        share = Unusable.among(result.turns).share
        unusable = math.nan if share is None else share
        return Score(
            value={"score": result.score, "unusable": unusable, "success": float(result.success), "regret": regret},
            answer=" ".join(kept["actions"]),
            explanation=kept["log"],
            metadata={"result": kept["result"], "record": kept["record"]},
        )

    return score


def _stored(flown: PilotedEpisode, agent: str) -> dict[str, Any]:
    """A flight as JSON values, which is what a sample can store."""
    return {
        "task": flown.episode.task.id,
        "result": PilotedRecord.of(flown).model_dump(mode="json"),
        "record": record_of(flown.episode, agent).to_json(),
        "actions": [step.action.name for step in flown.episode.path],
        "log": log_text(flown, agent),
    }


def _inspects(messages: list[ChatMessage]) -> list[ChatMessageSystem | ChatMessageUser | ChatMessageAssistant]:
    """Messages as Inspect has them, with their picture."""

    def content(message: ChatMessage) -> str | list[ContentText | ContentImage]:
        parts = message["content"]
        if isinstance(parts, str):
            return parts
        return [
            ContentText(text=part["text"]) if part["type"] == "text" else ContentImage(image=part["image_url"]["url"])
            for part in parts
        ]

    sent, _ = with_pictures(messages)
    return [ROLES[message["role"]](content=content(message)) for message in sent]


def _answer(output: ModelOutput) -> Answer:
    content = output.message.content if output.choices else ""
    thoughts = (
        [part.text for part in content if isinstance(part, ContentReasoning)] if isinstance(content, list) else []
    )
    return Answer(
        text=output.completion,
        reasoning="\n".join(thoughts) or None,
        finish_reason=FINISH_REASONS.get(output.stop_reason, output.stop_reason),
        model=output.model,
    )
