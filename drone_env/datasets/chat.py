"""Flights as conversations and as pairs of them, in the columns that TRL's trainers expect."""

import json
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from inspect import getdoc
from itertools import combinations, groupby
from pathlib import Path
from typing import Any

import numpy as np

from drone_env.core.actions import Action, Event
from drone_env.datasets.trajectories import DatasetConfig, Trajectory
from drone_env.errors import InvalidValueError
from drone_env.llm.text_episode import TextEpisode
from drone_env.llm.trl_environment import DroneEnvironment
from drone_env.models import DIRECTIONS

Row = dict[str, Any]
FACTS = {
    "tools": "the tools' schemas as JSON text; only if the pilot calls tools",
    "task": "id of the task",
    "seed": "number of the map",
}
COLUMNS = {
    "chat": {
        "messages": "the conversation",
        **FACTS,
        "agent": "name of the agent that flies",
        "score": "graded score of the flight",
        "optimal_score": "highest score that any flight over the map gets",
        "regret": "optimal_score - score",
        "actions": "for each assistant message: its actions",
        "optimal_actions": "for each of these actions: all actions that reach V*",
        "regrets": f"for each of these actions: V* - Q* of {', '.join(DIRECTIONS)}",
    },
    "preference": {
        "prompt": "the messages before the flight",
        "chosen": "the messages of the flight with less regret",
        "rejected": "the messages of the other flight over the same map",
        **FACTS,
        "chosen_agent": "name of the agent of `chosen`; likewise `rejected_agent`",
        "chosen_regret": "the optimum minus the score of `chosen`; likewise `rejected_regret`",
    },
}
"""The columns of each file, and their meaning."""


def tool_schemas() -> list[dict[str, Any]]:
    """The schemas of `DroneEnvironment`'s tools, as transformers derives them from the functions."""
    direction = {"type": "string", "enum": DIRECTIONS}
    kinds = {"direction": direction, "directions": {"type": "array", "items": direction}}
    schemas: list[dict[str, Any]] = []
    for tool, name in ((DroneEnvironment.fly, "direction"), (DroneEnvironment.fly_route, "directions")):
        what, argument, returns = (getdoc(tool) or "").split("\n\n")
        described = {**kinds[name], "description": argument.partition(f"{name}: ")[2]}
        function = {
            "name": tool.__name__,
            "description": what,
            "parameters": {"type": "object", "properties": {name: described}, "required": [name]},
            "return": {"type": "string", "description": returns.partition("\n")[2].strip()},
        }
        schemas.append({"type": "function", "function": function})
    return schemas


def chat_rows(config: DatasetConfig, flights: Sequence[Trajectory]) -> Iterator[Row]:
    """One row for each flight: see `COLUMNS`."""
    for flight in flights:
        q_values, actions = flight.infos["q_values"][:-1], flight.actions
        values, best = flight.infos["value"], flight.infos["optimal_actions"][:-1]
        turns = _turns(config, flight)
        yield {
            "messages": _messages(config, flight),
            **_facts(config, flight),
            "agent": flight.agent,
            "score": float(values[-1]),
            "optimal_score": float(values[0]),
            "regret": _regret(flight),
            "actions": [[Action(action).name for action in actions[turn]] for turn in turns],
            "optimal_actions": [[[DIRECTIONS[i] for i in np.flatnonzero(row)] for row in best[turn]] for turn in turns],
            "regrets": [(values[:-1, None] - q_values)[turn].tolist() for turn in turns],
        }


def preference_rows(config: DatasetConfig, flights: Sequence[Trajectory]) -> Iterator[Row]:
    """One row for each pair of flights over one map that differ in regret: see `COLUMNS`."""
    for _, of_map in groupby(flights, lambda flight: flight.seed):
        for chosen, rejected in combinations(sorted(of_map, key=_regret), 2):
            if _regret(chosen) < _regret(rejected):
                yield {
                    "prompt": _messages(config, chosen)[:2],
                    "chosen": _messages(config, chosen)[2:],
                    "rejected": _messages(config, rejected)[2:],
                    **_facts(config, chosen),
                    "chosen_agent": chosen.agent,
                    "rejected_agent": rejected.agent,
                    "chosen_regret": _regret(chosen),
                    "rejected_regret": _regret(rejected),
                }


@contextmanager
def row_writer(name: str, folder: Path, config: DatasetConfig) -> Generator[Callable[[Sequence[Trajectory]], None]]:
    """Write `NAME.jsonl`; each call of the yielded function appends the rows of whole maps.

    Raises:
        InvalidValueError: if there is no row at all.
    """
    rows_of = {"chat": chat_rows, "preference": preference_rows}[name]
    with (folder / f"{name}.jsonl").open("w", encoding="utf-8") as file:

        def write(flights: Sequence[Trajectory]) -> None:
            file.writelines(f"{json.dumps(row)}\n" for row in rows_of(config, flights))

        yield write
        if not file.tell():
            raise InvalidValueError("no pair: all flights over a map have equal regret: add agents or raise epsilon")


def _turns(config: DatasetConfig, flight: Trajectory) -> list[slice]:
    """The actions of each assistant message: all, one, or up to a delivery; at the end none."""
    steps = len(flight.actions)
    if config.turns == "plan":
        return [slice(0, steps)]
    delivered = flight.infos["event"][1:] == Event.DELIVERY
    ends = [i for i in range(1, steps + 1) if config.turns == "step" or delivered[i - 1] or i == steps]
    return [*map(slice, [0, *ends[:-1]], ends), slice(steps, steps)]


def _messages(config: DatasetConfig, flight: Trajectory) -> list[Row]:
    """The conversation of a flight."""
    episode = TextEpisode(config.task, flight.seed, config.text_prompt)
    messages: list[Row] = [*map(dict, episode.messages)]
    names = [Action(action).name for action in flight.actions]
    if config.turns == "plan":
        return [*messages, {"role": "assistant", "content": json.dumps({"actions": names})}]
    tool = "fly" if config.turns == "step" else "fly_route"
    for turn in _turns(config, flight)[:-1]:
        arguments = {"direction": names[turn][0]} if config.turns == "step" else {"directions": names[turn]}
        call = {"type": "function", "function": {"name": tool, "arguments": arguments}}
        messages.append({"role": "assistant", "content": "", "tool_calls": [call]})
        messages.append({"role": "tool", "name": tool, "content": episode.fly(names[turn])})
    return [*messages, {"role": "assistant", "content": "Done."}]


def _facts(config: DatasetConfig, flight: Trajectory) -> Row:
    tools = {} if config.turns == "plan" else {"tools": json.dumps(tool_schemas())}
    return {**tools, "task": config.task.id, "seed": flight.seed}


def _regret(flight: Trajectory) -> float:
    return float(flight.infos["value"][0] - flight.infos["value"][-1])
