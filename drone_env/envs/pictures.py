"""Pictures of many episodes at once."""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core.batch import Batch
from drone_env.core.episode import Episode
from drone_env.core.tables import STEPS
from drone_env.envs.rendering import draw_picture

SIZE = 360
"""Height of each picture in pixels: half of that of a single environment, as many stand side by side."""


class Pictures:
    """Pictures of the episodes of a batch, which keeps no trails itself: each is flown along in plain Python.

    Args:
        batch: The batch; call `follow` after each of its resets and steps.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.episodes = [Episode(batch.task, batch.reward_profile) for _ in range(batch.num_envs)]

    def follow(self, actions: npt.NDArray[Any] | None = None) -> None:
        """Bring the episodes to where the batch is.

        Args:
            actions: What the batch has just flown, integer[N]; None after a reset.
        """
        seeds, steps = self.batch.seeds.tolist(), self.batch.get_state()["states"][:, STEPS].tolist()
        flown = [0] * len(seeds) if actions is None else actions.tolist()
        for episode, seed, step, action in zip(self.episodes, seeds, steps, flown, strict=True):
            if step == 0:
                episode.reset(seed)
            elif step > episode.steps:
                episode.step(action)

    def draw(self) -> tuple[npt.NDArray[np.uint8], ...]:
        """N pictures, uint8[360, width, 3], RGB.

        Raises:
            EpisodeError: before the first reset.
        """
        return tuple(draw_picture(episode, SIZE) for episode in self.episodes)
