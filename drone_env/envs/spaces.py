"""The observation space of a task, the same in the single and the vector environment."""

import numpy as np
from gymnasium import spaces

from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.tasks import TaskConfig


def observation_space(task: TaskConfig) -> spaces.Dict:
    """`{"grid": uint8[H, W], "telemetry": float32[5]}`; the telemetry has 6 values where the task says so."""
    return spaces.Dict(
        {
            "grid": spaces.Box(0, N_CELL_KINDS - 1, (task.height, task.width), np.uint8),
            "telemetry": spaces.Box(0.0, 1.0, (task.telemetry_size,), np.float32),
        }
    )
