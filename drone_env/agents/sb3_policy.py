"""Models of Stable-Baselines3 as agents."""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.tasks import TaskConfig
from drone_env.envs.forms import observation_space, planes_space, to_planes, to_vector, vector_space
from drone_env.errors import InvalidValueError, UnsupportedTaskError
from drone_env.planning.from_observation import episode_of


class Sb3Agent(StatelessAgent):
    """Takes the likeliest action of a model (`predict(deterministic=True)`); a MaskablePPO gets the action mask.

    The observation space of the model decides what it gets: the plain observation, or the form of `OneHotPlanes` or
    `FlatObservation`.

    Raises:
        UnsupportedTaskError: if the task has no observation of that space.
        InvalidValueError: if the model is recurrent or takes the normalised observations of `VecNormalize`.
    """

    def __init__(self, task: TaskConfig, model: Any) -> None:
        plain = observation_space(task)
        forms: dict[str, tuple[Any, Callable[[Any], Any]]] = {
            "plain": (plain, dict),
            "planes": (planes_space(plain), to_planes),
            "flat": (vector_space(plain), to_vector),
        }
        fitting = [(name, to_form) for name, (space, to_form) in forms.items() if space == model.observation_space]
        if not fitting:
            allowed = " or ".join(f"{space}" for space, _ in forms.values())
            raise UnsupportedTaskError(
                "this model was trained on another task or form of the observation: "
                f"it takes {model.observation_space}; on {task.id!r} it can be {allowed}"
            )
        ((form, self._to_form),) = fitting
        normalised = model.get_vec_normalize_env() if hasattr(model, "get_vec_normalize_env") else None
        if hasattr(model.policy, "lstm_actor") or getattr(normalised, "norm_obs", False):
            raise InvalidValueError("recurrent models and VecNormalize(norm_obs=True) need a class of your own")
        self._task, self._policy = task, model.policy
        self._masked = "maskable" in type(model.policy).__module__
        weights = hashlib.sha256()
        for key, tensor in model.policy.state_dict().items():
            weights.update(key.encode() + tensor.detach().cpu().numpy().tobytes())
        policy = f"{type(model.policy).__module__}.{type(model.policy).__qualname__}"
        self.config: Mapping[str, object] = {
            "agent": "sb3",
            "version": 2,
            "policy": policy,
            "weights": weights.hexdigest()[:16],
            "form": form,
        }

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The likeliest actions, int64[N]."""
        masks: dict[str, Any] = {}
        if self._masked:
            each: Any = [{"grid": grid, "telemetry": values} for grid, values in zip(grids, telemetry, strict=True)]
            masks["action_masks"] = np.array([episode_of(self._task, one).action_mask() for one in each], np.bool_)
        observations = self._to_form({"grid": grids, "telemetry": telemetry})
        return np.asarray(self._policy.predict(observations, deterministic=True, **masks)[0], np.int64)
