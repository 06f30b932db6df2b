"""Flights as conversations: the requests that `drone-env infer` sends, and the agent's answers to them."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.datasets.trajectories import DatasetConfig, Trajectory
from drone_env.llm.prompt import Prompt, get_prompt
from drone_env.models import DIRECTIONS


def chat_rows(config: DatasetConfig, flight: Trajectory) -> Iterator[dict[str, Any]]:
    """One row for each request of a flight: every step or stop, or the whole route if the prompt asks for it.

    The answer is the agent's, also if a random one is flown instead.

    `step` is the number of earlier steps, `regret` is optimum - score, `options` are the actions in `DIRECTIONS`, or
    the stops in reach. For each of the `actions` of the answer, `optimal_actions` contains the best options, and
    `regrets` contains what each option loses: V* - Q*, or the best of `stop_values` minus its own.
    """
    prompt = get_prompt(config.prompt or "")
    turns = _stop_turns(flight) if prompt.stop else _action_turns(prompt, flight)
    episode = Episode(config.task, seed=flight.seed)
    for step, answer, columns in turns:
        episode.fly(flight.steps["action"][episode.steps : step])
        yield {
            "messages": [*prompt.messages(episode), {"role": "assistant", "content": answer}],
            "task": config.task.id,
            "seed": flight.seed,
            "step": step,
            "agent": flight.agent,
            "score": flight.score,
            "optimal_score": flight.optimal_score,
            "regret": flight.optimal_score - flight.score,
            **columns,
        }


def _action_turns(prompt: Prompt, flight: Trajectory) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Yield each request for actions: the number of earlier steps, the answer, and its columns."""
    steps = flight.steps
    regrets = steps["value"][:, None] - steps["q_values"]
    answers, length = steps["action" if prompt.plan else "agent_action"], len(regrets)
    for turn in [slice(0, length)] if prompt.plan else [slice(step, step + 1) for step in range(length)]:
        names = [Action(action).name for action in answers[turn]]
        optimal = [[DIRECTIONS[i] for i in np.flatnonzero(row)] for row in steps["optimal_actions"][turn]]
        answer = json.dumps({"actions": names}) if prompt.plan else names[0]
        chosen = {"options": DIRECTIONS, "actions": names, "optimal_actions": optimal}
        yield turn.start, answer, {**chosen, "regrets": regrets[turn].tolist()}


def _stop_turns(flight: Trajectory) -> Iterator[tuple[int, str, dict[str, Any]]]:
    """Yield each request for a stop, as `_action_turns`."""
    for step, values in flight.stops:
        best = max(values.values())
        optimal = [label for label, value in values.items() if value == best]
        chosen = {"options": list(values), "actions": optimal[:1], "optimal_actions": [optimal]}
        yield step, optimal[0], {**chosen, "regrets": [[best - value for value in values.values()]]}
