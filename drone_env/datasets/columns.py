"""The columns of a data set: what each is called, holds and means. One row is one step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.cells import Cell
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.datasets.trajectories import Trajectory


@dataclass(frozen=True)
class Column:
    """One column.

    `values` makes its part of one flight: an array [T, ...], a list, or one value for all steps.
    """

    name: str
    dtype: str
    """As Arrow calls it."""
    shape: tuple[int, ...]
    """Of one entry, () for a scalar; an entry is stored flat, row by row."""
    text: str
    values: Callable[[Trajectory], Any]


def columns(task: TaskConfig) -> list[Column]:
    """The columns of a task's data sets, in order."""
    actions = (N_ACTIONS,)
    cells = ", ".join(f"{int(cell)} {cell.name.lower()}" for cell in Cell)
    telemetry = "x/width, y/height, battery share, target x/width, target y/height"
    telemetry += ", share of steps left" if task.telemetry_size > 5 else ""
    ground = ", ".join(kind.name.lower() for kind in TERRAIN)
    telemetry += f", 1 for the kind of the cell below the drone of {ground}" if task.telemetry_size > 6 else ""
    names = [event.name.lower() for event in Event]
    return [
        Column("episode", "int64", (), "number of the flight, from 0", lambda f: f.number),
        Column("task", "string", (), "id of the task", lambda _: task.id),
        Column("task_version", "int32", (), "version of the task", lambda _: task.version),
        Column("seed", "int64", (), "number of the map", lambda f: f.seed),
        Column("agent", "string", (), "who flew", lambda f: f.agent),
        Column(
            "step", "int32", (), "steps flown before this one, from 0", lambda f: np.arange(f.steps, dtype=np.int32)
        ),
        Column("grid", "uint8", (task.height, task.width), f"cell ids: {cells}", lambda f: f.grids[:-1]),
        Column("telemetry", "float32", (task.telemetry_size,), telemetry, lambda f: f.telemetry[:-1]),
        Column("action_mask", "int8", actions, "0 for each action that would bump", lambda f: f.action_masks[:-1]),
        Column("action", "int8", (), "what was flown: 0 up, 1 down, 2 left, 3 right, 4 wait", lambda f: f.actions),
        Column(
            "agent_action", "int8", (), "what the agent chose; chance may have flown another", lambda f: f.agent_actions
        ),
        Column("reward", "float64", (), "what the step paid, by the reward profile", lambda f: f.rewards),
        Column(
            "return_to_go", "float64", (), "undiscounted sum of the rewards from here on", lambda f: f.returns_to_go
        ),
        Column("terminated", "bool", (), "whether the step ended the flight", lambda f: f.terminated),
        Column("event", "string", (), "what happened in the step", lambda f: [names[event] for event in f.events[1:]]),
        Column(
            "score", "float64", (), "graded score after the step, provisional before the end", lambda f: f.scores[1:]
        ),
        Column("final_score", "float64", (), "graded score of the flight", lambda f: f.scores[-1]),
        Column(
            "optimal_score", "float64", (), "highest score that any flight over the map gets", lambda f: f.values[0]
        ),
        Column("value", "float64", (), "V*: highest score that can still be reached", lambda f: f.values[:-1]),
        Column(
            "q_values", "float64", actions, "Q*: highest score still in reach after each action", lambda f: f.q_values
        ),
        Column("regret", "float64", (), "V* - Q* of the action: score given away for good", lambda f: f.regrets),
        Column("optimal_actions", "bool", actions, "whether each action reaches V*", lambda f: f.optimal_actions),
    ]
