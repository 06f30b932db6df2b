"""The observation wrappers for vector environments, in `NEXT_STEP` and `DISABLED` autoreset mode.

In `SAME_STEP` mode, apply `forms.to_planes` or `forms.to_vector` to the observations.
"""

from typing import Any

import numpy.typing as npt
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from gymnasium.vector.utils import batch_space

from drone_env.envs.forms import planes_space, to_planes, to_vector, vector_space

Array = npt.NDArray[Any]
Observations = dict[str, Array]


# Older Gymnasium versions have no type parameters here.
class OneHotPlanes(VectorObservationWrapper):  # pyright: ignore[reportMissingTypeArgument]
    """Replace `grid` by one-hot planes for convolutional networks: uint8[N, kinds, H, W]. Keep `telemetry`."""

    def __init__(self, env: VectorEnv[Observations, Array, Array]) -> None:
        super().__init__(env)
        self.autoreset_mode = env.metadata["autoreset_mode"]  # TorchRL reads it; Gymnasium's wrappers do not forward it
        self.single_observation_space = planes_space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Observations) -> Observations:
        """The observations with one-hot planes."""
        return to_planes(observations)


class FlatObservation(VectorObservationWrapper):  # pyright: ignore[reportMissingTypeArgument]
    """One vector per drone for dense networks: the planes, then the telemetry; float32[N, kinds * H * W + n]."""

    def __init__(self, env: VectorEnv[Observations, Array, Array]) -> None:
        super().__init__(env)
        self.autoreset_mode = env.metadata["autoreset_mode"]
        self.single_observation_space = vector_space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Observations) -> Array:
        """The observations as vectors."""
        return to_vector(observations)
