"""Flights as conversations: the requests that `drone-env infer` sends, and the agent's answers to them."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.datasets.trajectories import DatasetConfig, Trajectory
from drone_env.llm.prompt import Prompt, get_prompt
from drone_env.models import DIRECTIONS


def chat_rows(config: DatasetConfig, flight: Trajectory) -> Iterator[dict[str, Any]]:
    """One row for each request of a flight: every step, or the whole route if the prompt asks for it.

    The answer to one step is the agent's action, also if a random one is flown instead.

    `step` is the number of earlier steps, `regret` is optimum - score. For each of the `actions` of the answer,
    `optimal_actions` contains all actions that reach V*, and `regrets` contains V* - Q* of each action in `DIRECTIONS`.
    """
    prompt, episode, steps = get_prompt(config.prompt or ""), Episode(config.task, seed=flight.seed), flight.steps
    regrets = steps["value"][:, None] - steps["q_values"]
    answers, length = steps["action" if prompt.plan else "agent_action"], len(regrets)
    for turn in [slice(0, length)] if prompt.plan else [slice(step, step + 1) for step in range(length)]:
        names = [Action(action).name for action in answers[turn]]
        yield {
            "messages": [*prompt.messages(episode), {"role": "assistant", "content": _answer(prompt, names)}],
            "task": config.task.id,
            "seed": flight.seed,
            "step": turn.start,
            "agent": flight.agent,
            "score": flight.score,
            "optimal_score": flight.optimal_score,
            "regret": flight.optimal_score - flight.score,
            "actions": names,
            "optimal_actions": [[DIRECTIONS[i] for i in np.flatnonzero(row)] for row in steps["optimal_actions"][turn]],
            "regrets": regrets[turn].tolist(),
        }
        episode.fly(steps["action"][turn])


def _answer(prompt: Prompt, names: Sequence[str]) -> str:
    return json.dumps({"actions": names}) if prompt.plan else names[0]
