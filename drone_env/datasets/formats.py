"""The files of a data set: its columns as one Parquet file, and whole episodes as a Minari data set in HDF5."""

# pyarrow declares no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

import json
import math
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.cells import Cell
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.datasets.config import DatasetConfig
from drone_env.datasets.trajectories import Trajectory
from drone_env.errors import DISTRIBUTION, needs

Write = Callable[[Sequence[Trajectory]], None]
"""Appends flights to a file."""
PARQUET_FILE, MINARI_FOLDER = "steps.parquet", "minari"


@dataclass(frozen=True)
class Column:
    """One column, with one row for each step.

    `values` returns its part of one flight: an array [T, ...], a list, or one value for all steps.
    """

    name: str
    dtype: str
    """As Arrow names it."""
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
    events = [event.name.lower() for event in Event]
    action = "what was flown: 0 up, 1 down, 2 left, 3 right, 4 wait"
    agent_action = "what the agent chose; chance may have flown another"
    optimum = "highest score that any flight over the map gets"
    return [
        Column("episode", "int64", (), "number of the flight, from 0", lambda f: f.number),
        Column("task", "string", (), "id of the task", lambda _: task.id),
        Column("task_version", "int32", (), "version of the task", lambda _: task.version),
        Column("seed", "int64", (), "number of the map", lambda f: f.seed),
        Column("agent", "string", (), "who flew", lambda f: f.agent),
        Column("step", "int32", (), "steps flown before this one, from 0", lambda f: np.arange(f.steps, dtype="i4")),
        Column("grid", "uint8", (task.height, task.width), f"cell ids: {cells}", lambda f: f.grids[:-1]),
        Column("telemetry", "float32", (task.telemetry_size,), telemetry, lambda f: f.telemetry[:-1]),
        Column("action_mask", "int8", actions, "0 for each action that would bump", lambda f: f.action_masks[:-1]),
        Column("action", "int8", (), action, lambda f: f.actions),
        Column("agent_action", "int8", (), agent_action, lambda f: f.agent_actions),
        Column("reward", "float64", (), "what the step paid, by the reward profile", lambda f: f.rewards),
        Column(
            "return_to_go", "float64", (), "undiscounted sum of the rewards from here on", lambda f: f.returns_to_go
        ),
        Column("terminated", "bool", (), "whether the step ended the flight", lambda f: f.terminated),
        Column("event", "string", (), "what happened in the step", lambda f: [events[event] for event in f.events[1:]]),
        Column(
            "score", "float64", (), "graded score after the step, provisional before the end", lambda f: f.scores[1:]
        ),
        Column("final_score", "float64", (), "graded score of the flight", lambda f: f.scores[-1]),
        Column("optimal_score", "float64", (), optimum, lambda f: f.values[0]),
        Column("value", "float64", (), "V*: highest score that can still be reached", lambda f: f.values[:-1]),
        Column(
            "q_values", "float64", actions, "Q*: highest score still in reach after each action", lambda f: f.q_values
        ),
        Column("regret", "float64", (), "V* - Q* of the action: score given away for good", lambda f: f.regrets),
        Column("optimal_actions", "bool", actions, "whether each action reaches V*", lambda f: f.optimal_actions),
    ]


@contextmanager
def parquet_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Writes `steps.parquet` into a folder; it is complete at the end of the `with`. Each call makes one row group.

    The schema's metadata holds the configuration as JSON under `drone_env`; each field's holds its meaning and shape.

    Raises:
        MissingPackageError: if pyarrow is not installed.
    """
    with needs("data"):
        import pyarrow
        import pyarrow.parquet

    def field(column: Column) -> Any:
        item = pyarrow.type_for_alias(column.dtype)
        element = pyarrow.field("element", item, nullable=False)
        kind = pyarrow.list_(element, math.prod(column.shape)) if column.shape else item
        metadata = {"description": column.text, "shape": json.dumps(column.shape)}
        return pyarrow.field(column.name, kind, nullable=False, metadata=metadata)

    def array(column: Column, trajectories: Sequence[Trajectory]) -> Any:
        kind = schema.field(column.name).type
        parts = [(trajectory.steps, column.values(trajectory)) for trajectory in trajectories]
        values = np.concatenate([np.full(steps, part) if np.ndim(part) == 0 else part for steps, part in parts])
        if not column.shape:
            return pyarrow.array(values, kind)
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.reshape(-1), kind.value_type), type=kind)

    def write(trajectories: Sequence[Trajectory]) -> None:
        table = pyarrow.Table.from_arrays([array(column, trajectories) for column in described], schema=schema)
        file.write_table(table, row_group_size=len(table))

    described = columns(config.task)
    schema = pyarrow.schema(map(field, described), {"drone_env": json.dumps(config.as_json())})
    with pyarrow.parquet.ParquetWriter(folder / PARQUET_FILE, schema, compression="zstd") as file:
        yield write


@contextmanager
def minari_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Writes a Minari data set into `minari/<dataset id>` of a folder.

    `minari.load_dataset` finds it if the environment variable `MINARI_DATASETS_PATH` names that `minari` folder.
    `infos` have T + 1 entries, one for each observation, as Minari's own collector writes them; in columns about
    actions, the last entry is NaN, False or -1.

    Raises:
        MissingPackageError: if Minari, which asks for Python 3.11, or h5py is not installed.
    """
    with needs("data"):
        import h5py  # noqa: F401  # pyright: ignore[reportUnusedImport] - Minari asks for it only when it writes
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    # Declared to take lists, which it does not need: arrays are written faster.
    buffer: Any = EpisodeBuffer
    env = gymnasium.make(config.task.gym_id, reward_profile=config.reward_profile)
    # Minari reads a relative path as relative to itself when it adds up sizes.
    home = folder.resolve() / MINARI_FOLDER / config.minari_id
    home.mkdir(parents=True)
    storage = MinariStorage.new(
        home / "data",
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
        data_format="hdf5",
        jpeg_encoding=False,
    )
    about = config.as_json()
    storage.update_metadata(
        {
            "dataset_id": config.minari_id,
            "minari_version": minari.__version__,
            "algorithm_name": f"{', '.join(config.agents)} (epsilon {config.epsilon:g})",
            "description": "Flights with the exact V*, Q* and regret of every step, in infos.",
            "requirements": [f"{DISTRIBUTION}>={about['package_version']}"],
            "drone_env": about,
        }
    )

    def write(trajectories: Sequence[Trajectory]) -> None:
        storage.update_episodes(buffer(**_episode(trajectory)) for trajectory in trajectories)
        metadata = [
            {"agent": flight.agent, "final_score": float(flight.scores[-1]), "optimal_score": float(flight.values[0])}
            for flight in trajectories
        ]
        storage.update_episode_metadata(metadata, [trajectory.number for trajectory in trajectories])

    yield write


def _episode(trajectory: Trajectory) -> dict[str, Any]:
    return {
        "id": trajectory.number,
        "seed": trajectory.seed,
        "observations": {"grid": trajectory.grids, "telemetry": trajectory.telemetry},
        "actions": trajectory.actions.astype(np.int64),
        "rewards": trajectory.rewards,
        "terminations": trajectory.terminated,
        "truncations": np.zeros(trajectory.steps, np.bool_),
        "infos": {
            "action_mask": trajectory.action_masks,
            "score": trajectory.scores,
            "event": trajectory.events,
            "value": trajectory.values,
            "q_values": np.concatenate([trajectory.q_values, np.full((1, N_ACTIONS), np.nan)]),
            "regret": np.append(trajectory.regrets, np.nan),
            "optimal_actions": np.concatenate([trajectory.optimal_actions, np.zeros((1, N_ACTIONS), np.bool_)]),
            "agent_action": np.append(trajectory.agent_actions, np.int8(-1)),
        },
    }
