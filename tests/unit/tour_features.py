"""Tasks, observations and networks that the tests of the tour network share."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_features import FeatureEncoder, Features
from drone_env.core.batch import Batch
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.planning.from_observation import read_observations
from tests.which_tasks import SMALL

HARD = get_task("skyline_hard")
OWN = {
    "16 parcels, 20 pads": replace(HARD, deliveries=16, pads=20, width=20, height=20, battery_capacity=60),
    "efficiency counts always": replace(HARD, efficiency_needs_all=False),
    "pads without charges": replace(HARD, charge_rate=0),
    "terrain without pads": replace(HARD, pads=0, charge_rate=0, battery_capacity=200),
    "uniform, a short battery": replace(get_task("hard"), battery_capacity=25),
    "uniform, 16 parcels, not square": replace(get_task("hard"), deliveries=16, width=30, height=9),
}
"""Custom tasks."""
EVERY_TASK = {**SMALL, **{name: replace(task, id="own", short_name="own") for name, task in OWN.items()}}


def observations(task: TaskConfig, maps: int, steps: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Observations of random flights, at every third step."""
    batch, rng = Batch(task, maps), np.random.default_rng(0)
    batch.reset(np.arange(maps))
    grids: list[Any] = []
    telemetry: list[Any] = []
    for t in range(steps):
        if t % 3 == 0:
            grids.append(batch.grids.copy())
            telemetry.append(batch.telemetry.copy())
        batch.step(rng.integers(0, 5, maps))
    return np.concatenate(grids), np.concatenate(telemetry)


def encoded(encoder: FeatureEncoder, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Features:
    return encoder.encode(*read_observations(encoder.task, grids, telemetry))


def features_of(encoder: FeatureEncoder, observation: Observation) -> Features:
    return encoded(encoder, observation["grid"][None], observation["telemetry"][None])
