"""`build_dataset`: write flights as rows of steps, as conversations, and as a Minari dataset."""

# pyarrow declares no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

import json
import math
import shutil
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pyarrow
import pyarrow.parquet
from jinja2 import Template

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.datasets.chat import chat_rows
from drone_env.datasets.trajectories import DatasetConfig, Trajectory, fly_map
from drone_env.errors import InvalidValueError, needs
from drone_env.files import locked
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.folder import shipped_results

Write = Callable[[Sequence[Trajectory]], None]
"""Appends flights to a file."""
PARQUET_FILE, CHAT_FILE, MINARI_FOLDER = "steps.parquet", "chat.jsonl", "minari"
ROWS_PER_GROUP = 1 << 14
"""Minimum number of rows in memory before they are written."""


@dataclass(frozen=True)
class Column:
    """One column, with one row for each step."""

    name: str
    dtype: str
    """Name of the type in Arrow."""
    shape: tuple[int, ...]
    """Shape of one entry, () for a scalar; entries are stored flat in C order."""
    text: str
    values: Callable[[Trajectory], Any]
    """Returns the column of one flight: an array [T, ...], a list, or one value for all steps."""


def build_dataset(config: DatasetConfig, out: Path, on_map: Callable[[], object] = lambda: None) -> int:
    """Fly and write a dataset. If an error occurs, nothing is left.

    Args:
        config: The configuration.
        out: The folder to make, in an existing one; it may exist if it is empty.
        on_map: Called after each map.

    Returns:
        The number of rows.

    Raises:
        InvalidValueError: if the folder is not empty or cannot be made.
        MissingPackageError: if Minari is asked for and not installed.
        TooLargeError: if the exact values of a map would take too much memory.
        OSError: if it cannot be written.
    """
    if not out.name or not out.parent.is_dir():
        raise InvalidValueError(f"a dataset needs a folder in an existing one, got {str(out)!r}")
    # In the same file system, so that the final move is one atomic step. The next run removes what a killed one leaves.
    part = out.with_name(f"{out.name}.part")
    folder = part / "dataset"
    with locked(part / "lock", f"another process is writing {out}"):
        try:
            if out.exists() and not (out.is_dir() and not any(out.iterdir())):
                raise InvalidValueError(f"{out} exists and is not an empty folder: name another")
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            rows = _write(config, folder, on_map)
            if out.exists():
                out.rmdir()
            folder.rename(out)
        finally:
            # `part` last: as soon as this lock is removed, another process may begin, and then it stays.
            for path in (folder, part):
                shutil.rmtree(path, ignore_errors=True)
    return rows


def _write(config: DatasetConfig, folder: Path, on_map: Callable[[], object]) -> int:
    """Write all flights, whole ones in each row group, and return the number of rows."""
    rows, batch = 0, list[Trajectory]()
    with ExitStack() as stack:
        writes = [stack.enter_context(_parquet_writer(folder, config))]
        if config.prompt is not None:
            writes.append(stack.enter_context(_chat_writer(folder, config)))
        if config.minari:
            writes.append(_minari_writer(folder, config))
        for seed in config.seeds:
            batch += fly_map(config, seed)
            steps = sum(map(_length, batch))
            if seed == config.seeds[-1] or steps >= ROWS_PER_GROUP:
                for write in writes:
                    write(batch)
                rows, batch = rows + steps, []
            on_map()
    card = Template(Path(__file__).with_name("card.md").read_text(encoding="utf-8"))
    about = card.render(config.as_json(), rows=rows, steps=PARQUET_FILE, chat=CHAT_FILE)
    (folder / "README.md").write_text(f"{about}\n", encoding="utf-8")
    return rows


def columns(task: TaskConfig) -> list[Column]:
    """Return the columns of a task's datasets, in order."""
    per_action = (N_ACTIONS,)
    grid = (task.height, task.width)
    cells = ", ".join(f"{int(cell)} {cell.name.lower()}" for cell in Cell)
    telemetry = "x/width, y/height, battery share, target x/width, target y/height"
    telemetry += ", share of steps left" if task.telemetry_size > 5 else ""
    ground = ", ".join(kind.name.lower() for kind in TERRAIN)
    telemetry += f", 1 for the kind of the cell below the drone of {ground}" if task.telemetry_size > 6 else ""
    names = np.array([event.name.lower() for event in Event])
    flown = "action taken: 0 up, 1 down, 2 left, 3 right, 4 wait"
    optimum = "highest score that any flight over the map gets"
    score = "graded score after the step, provisional before the end"
    best = "Q*: highest score that can be reached after each action"

    def step(name: str, dtype: str, shape: tuple[int, ...], text: str) -> Column:
        return Column(name, dtype, shape, text, lambda flight: flight.steps[name])

    return [
        Column("episode", "int64", (), "number of the flight, from 0", lambda f: f.number),
        Column("task", "string", (), "id of the task", lambda _: task.id),
        Column("seed", "int64", (), "number of the map", lambda f: f.seed),
        Column("agent", "string", (), "name of the agent", lambda f: f.agent),
        Column("step", "int32", (), "number of earlier steps, from 0", lambda f: np.arange(_length(f))),
        step("grid", "uint8", grid, f"cell ids: {cells}"),
        step("telemetry", "float32", (task.telemetry_size,), telemetry),
        step("action_mask", "int8", per_action, "0 for each action that would bump"),
        step("action", "int8", (), flown),
        step("agent_action", "int8", (), "the agent's action; a random one may replace it"),
        step("reward", "float64", (), "reward of the step, by the reward profile"),
        step("terminated", "bool", (), "whether the step ended the flight"),
        Column("event", "string", (), "event of the step", lambda f: names[f.steps["event"]]),
        step("score", "float64", (), score),
        Column("optimal_score", "float64", (), optimum, lambda f: f.optimal_score),
        step("value", "float64", (), "V*: highest score that can still be reached"),
        step("q_values", "float64", per_action, best),
        step("regret", "float64", (), "V* - Q* of the action: score lost for good"),
        step("optimal_actions", "bool", per_action, "whether each action reaches V*"),
    ]


def _length(flight: Trajectory) -> int:
    return len(flight.steps["action"])


@contextmanager
def _parquet_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Write `steps.parquet`; each call of the yielded function appends one row group.

    The schema's metadata contains the configuration as JSON under `drone_env`; each field's its meaning and shape.
    """

    def field(column: Column) -> Any:
        item = pyarrow.type_for_alias(column.dtype)
        element = pyarrow.field("element", item, nullable=False)
        kind = pyarrow.list_(element, math.prod(column.shape)) if column.shape else item
        metadata = {"description": column.text, "shape": json.dumps(column.shape)}
        return pyarrow.field(column.name, kind, nullable=False, metadata=metadata)

    def array(column: Column, trajectories: Sequence[Trajectory]) -> Any:
        kind = schema.field(column.name).type
        parts = [(_length(flight), column.values(flight)) for flight in trajectories]
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
def _chat_writer(folder: Path, config: DatasetConfig) -> Generator[Write, None, None]:
    """Write `chat.jsonl`; each call of the yielded function appends the rows of whole flights."""
    with (folder / CHAT_FILE).open("w", encoding="utf-8") as file:
        yield lambda flights: file.writelines(
            f"{json.dumps(row)}\n" for flight in flights for row in chat_rows(config, flight)
        )


def _minari_writer(folder: Path, config: DatasetConfig) -> Write:
    """Make a Minari dataset in `minari/<dataset id>`; each call of the returned function appends flights."""
    with needs("data"):
        import h5py as h5py  # Minari imports it only when it writes
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    # Declared with lists, but arrays are written faster.
    buffer: Any = EpisodeBuffer
    # Without Gymnasium's limit: as a plain number in JSON it would truncate flights of the recovered environment.
    env = gymnasium.make(config.task.gym_id, max_episode_steps=-1, reward_profile=config.reward_profile)
    # Minari resolves a relative path against itself when it adds up sizes.
    home = folder.resolve() / MINARI_FOLDER / config.minari_id
    home.mkdir(parents=True)
    storage = MinariStorage.new(home / "data", env.observation_space, env.action_space, env.spec)
    storage.update_metadata(
        {
            "dataset_id": config.minari_id,
            "minari_version": minari.__version__,
            "algorithm_name": f"{', '.join(config.agents)} (epsilon {config.epsilon:g})",
            "description": "Flights with the exact V*, Q* and regret of every step, in infos.",
            "drone_env": config.as_json(),
            **_reference_scores(config),
        }
    )

    def episode(flight: Trajectory) -> Any:
        steps, start = flight.steps, Episode(config.task, seed=flight.seed)
        end: dict[str, Any] = {
            **flight.end,
            "value": flight.score,
            "q_values": np.full(N_ACTIONS, np.nan),
            "regret": np.nan,
            "optimal_actions": np.zeros(N_ACTIONS, bool),
            "agent_action": -1,
        }
        # One entry for each of T + 1 states, also in infos, as Minari's own collector writes them.
        infos = {name: np.append(steps[name], [last], axis=0) for name, last in end.items()}
        infos |= {name: np.append(getattr(start, name), steps[name]) for name in ("event", "score")}
        return buffer(
            id=flight.number,
            seed=flight.seed,
            observations={name: infos.pop(name) for name in ("grid", "telemetry")},
            actions=steps["action"],
            rewards=steps["reward"],
            terminations=steps["terminated"],
            truncations=np.zeros_like(steps["terminated"]),
            infos=infos,
        )

    def write(flights: Sequence[Trajectory]) -> None:
        storage.update_episodes(map(episode, flights))
        about = [{"agent": f.agent, "final_score": f.score, "optimal_score": f.optimal_score} for f in flights]
        storage.update_episode_metadata(about, [flight.number for flight in flights])

    return write


def _reference_scores(config: DatasetConfig) -> dict[str, float]:
    """Return the mean scores of the random agent and of the optimum, for `minari.get_normalized_score`.

    They are those of the first 1,000 test maps if the package contains these results, else of the dataset's maps.
    """
    key = episodes_key(config.task, "random", split_seeds("test", 1000), "test")
    results = shipped_results(key) or run_episodes(episodes_key(config.task, "random", config.seeds))
    return {"ref_min_score": float(results.scores.mean()), "ref_max_score": float(results.optimal_scores.mean())}
