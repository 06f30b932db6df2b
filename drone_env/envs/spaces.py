"""The observation space of a task, the same in the single and the vector environment."""

import numpy as np
from gymnasium import spaces

from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.tasks import TaskConfig


def observation_space(task: TaskConfig) -> spaces.Dict:
    """`{"grid": uint8[H, W], "telemetry": float32[telemetry_size]}`: 5, 6 or 13 values, as the task says."""
    return spaces.Dict(
        {
            "grid": spaces.Box(0, N_CELL_KINDS - 1, (task.height, task.width), np.uint8),
            "telemetry": spaces.Box(0.0, 1.0, (task.telemetry_size,), np.float32),
        }
    )
