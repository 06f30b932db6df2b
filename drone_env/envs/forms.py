"""The observation space, and observations in other forms: one-hot planes, one vector, or stops as the drone sees them.

Shapes are those of one drone. Leading axes, such as the batch axis, are preserved.
"""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig

Shown = Observation | Mapping[str, npt.NDArray[Any]]
KINDS = np.arange(N_CELL_KINDS, dtype=np.uint8)[:, None, None]


def observation_space(task: TaskConfig) -> spaces.Dict:
    """`{"grid": uint8[H, W], "telemetry": float32[telemetry_size]}`: 5, 6 or 13 values."""
    return spaces.Dict(
        {
            "grid": spaces.Box(0, N_CELL_KINDS - 1, (task.height, task.width), np.uint8),
            "telemetry": spaces.Box(0.0, 1.0, (task.telemetry_size,), np.float32),
        }
    )


def one_hot(grid: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """uint8[kinds, H, W] of 0 and 1 from cell ids uint8[H, W]: plane i marks the cells of kind i."""
    return (grid[..., None, :, :] == KINDS).view(np.uint8)


def to_planes(observation: Shown) -> dict[str, npt.NDArray[Any]]:
    """The observation with the grid as one-hot planes; the telemetry is not copied."""
    return {"grid": one_hot(observation["grid"]), "telemetry": observation["telemetry"]}


def to_vector(observation: Shown) -> npt.NDArray[np.float32]:
    """float32[kinds * H * W + n]: the one-hot planes, row by row, then the telemetry."""
    planes = one_hot(observation["grid"])
    flat = planes.reshape(*planes.shape[:-3], -1)
    return np.concatenate([flat, observation["telemetry"]], axis=-1, dtype=np.float32)


def planes_space(space: Any) -> spaces.Dict:
    """The space of `to_planes(observation)`, from the space of plain observations."""
    shape = (N_CELL_KINDS, *space["grid"].shape)
    return spaces.Dict({"grid": spaces.Box(0, 1, shape, np.uint8), "telemetry": space["telemetry"]})


def vector_space(space: Any) -> spaces.Box:
    """The space of `to_vector(observation)`, from the space of plain observations."""
    return cast(spaces.Box, spaces.flatten_space(planes_space(space)))


DIRECTION_FEATURES = 6
"""Of the target: its distance along x and y, the signs, and the absolute values."""


class StopEntries:
    """The stops, waiting parcels and pads, as the drone sees them: `{"entries": int32[L], "features": float32[n + 6]}`.

    Entries are rows of an embedding table, whose sum a network takes (`torch.nn.EmbeddingBag`, `padding_idx=0`): cost
    and first action of the cheapest path to each stop, units to spare there, the battery, and the cells beside the
    drone (`planning.nearby`); with `deliveries`, also how many parcels nearest neighbour delivers from each stop.
    Features are the telemetry, and the direction of the target: its distance along x and y, the signs, and the absolute
    values.

    Args:
        task: The task.
        deliveries: Whether to add those entries.
    """

    def __init__(self, task: TaskConfig, deliveries: bool = False) -> None:
        # Imported lazily: compiling takes seconds.
        from drone_env.planning.nearby import ALL_ENTRIES, ENTRIES, entry_count

        self.task, self._deliveries = task, deliveries
        self.table_size = ALL_ENTRIES if deliveries else ENTRIES
        """Rows of the embedding table, the same for every task."""
        self.space = spaces.Dict(
            {
                "entries": spaces.Box(0, self.table_size - 1, (entry_count(task, deliveries),), np.int32),
                "features": spaces.Box(-1.0, 1.0, (task.telemetry_size + DIRECTION_FEATURES,), np.float32),
            }
        )

    def __call__(self, observation: Shown) -> dict[str, npt.NDArray[Any]]:
        """The observation in this form."""
        from drone_env.planning.nearby import entries_of

        grid, telemetry = observation["grid"], observation["telemetry"]
        flat = np.reshape(telemetry, (-1, telemetry.shape[-1]))
        entries = entries_of(self.task, grid.reshape(-1, *grid.shape[-2:]), flat, self._deliveries)
        to_target = telemetry[..., 3:5] - telemetry[..., :2]
        features = [telemetry, to_target, np.sign(to_target), np.abs(to_target)]
        return {
            "entries": entries.reshape(*telemetry.shape[:-1], -1),
            "features": np.concatenate(features, axis=-1, dtype=np.float32),
        }
