"""The observation wrappers for vector environments, in `NEXT_STEP` and `DISABLED` autoreset mode.

In `SAME_STEP` mode, apply `forms.to_planes` or `forms.to_vector` to the observations.
"""

from collections.abc import Callable
from typing import Any

import numpy.typing as npt
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from gymnasium.vector.utils import batch_space

from drone_env.envs.forms import planes_space, to_planes, to_vector, vector_space

Array = npt.NDArray[Any]
Observations = dict[str, Array]


# Older Gymnasium versions have no type parameters here.
class ObservationForm(VectorObservationWrapper):  # pyright: ignore[reportMissingTypeArgument]
    """Base class of the wrappers: `form` converts observations, and `form_space` their space."""

    form: Callable[[Any], Any]
    form_space: Callable[[Any], Any]

    def __init__(self, env: VectorEnv[Observations, Array, Array]) -> None:
        super().__init__(env)
        self.autoreset_mode = env.metadata["autoreset_mode"]  # TorchRL reads it; Gymnasium's wrappers do not forward it
        self.single_observation_space = self.form_space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Observations) -> Any:
        """The observations in the form of the wrapper."""
        return self.form(observations)


class OneHotPlanes(ObservationForm):
    """Replace `grid` by one-hot planes for convolutional networks: uint8[N, kinds, H, W]. Keep `telemetry`."""

    form, form_space = staticmethod(to_planes), staticmethod(planes_space)


class FlatObservation(ObservationForm):
    """One vector per drone for dense networks: the planes, then the telemetry; float32[N, kinds * H * W + n]."""

    form, form_space = staticmethod(to_vector), staticmethod(vector_space)
