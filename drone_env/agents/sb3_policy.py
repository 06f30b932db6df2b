"""Policies of Stable-Baselines3 as agents: from a model, or from the file that `model.save` writes."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.tasks import TaskConfig
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.files import open_file
from drone_env.planning.from_observation import episode_of


class Sb3Agent(StatelessAgent):
    """Takes the likeliest action of a policy (`predict(deterministic=True)`).

    A policy of MaskablePPO gets the action mask.

    Args:
        task: The task.
        policy: The policy of a model.
        wrapper: The observation wrapper of its training; None for none.

    Raises:
        CheckpointError: if the observation space of the policy is not that of the wrapped task.
        InvalidValueError: if the policy is recurrent.
    """

    def __init__(self, task: TaskConfig, policy: Any, wrapper: Callable[[Any], Any] | None = None) -> None:
        env = DroneDeliveryEnv(task)
        self._wrapped: Any = env if wrapper is None else wrapper(env)
        name = "none" if wrapper is None else getattr(wrapper, "__name__", str(wrapper))
        expected, space = policy.observation_space, self._wrapped.observation_space
        if space != expected:
            raise CheckpointError(f"this policy takes {expected}; {task.id!r} with wrapper {name} has {space}")
        if hasattr(policy, "lstm_actor"):
            raise InvalidValueError("recurrent policies are not supported: write an agent that keeps their state")
        self._task, self._policy = task, policy
        self._masked = "maskable" in type(policy).__module__
        policy.set_training_mode(False)
        weights = hashlib.sha256()
        for key, tensor in policy.state_dict().items():
            weights.update(key.encode() + tensor.detach().cpu().numpy().tobytes())
        self.config: Mapping[str, object] = {
            "agent": "sb3",
            "version": 1,
            "policy": f"{type(policy).__module__}.{type(policy).__qualname__}",
            "weights": weights.hexdigest()[:16],
            "wrapper": name,
        }

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The likeliest actions, int64[N]."""
        each: Any = [{"grid": grid, "telemetry": values} for grid, values in zip(grids, telemetry, strict=True)]
        masks: dict[str, Any] = {}
        if self._masked:
            masks["action_masks"] = np.array([episode_of(self._task, one).action_mask() for one in each], np.bool_)
        return np.asarray(self._policy.predict(self._wrap(each), deterministic=True, **masks)[0], np.int64)

    def _wrap(self, obs: Any) -> Any:
        """The wrapped observations of N episodes, stacked."""
        if not isinstance(self._wrapped, DroneDeliveryEnv):
            obs = [self._wrapped.observation(one) for one in obs]
        if isinstance(obs[0], dict):
            return {name: np.stack([one[name] for one in obs]) for name in obs[0]}
        return np.stack(obs)


def load_policy(file: Path, task: TaskConfig, wrapper: Any) -> Sb3Agent:
    """The policy in a file that `model.save` wrote, of any algorithm. Reading the file runs code from it.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it contains no policy, or one for other observations.
        InvalidValueError: if Stable-Baselines3 is not installed, or the policy is recurrent.
    """
    try:
        from stable_baselines3.common.save_util import load_from_zip_file
    except ModuleNotFoundError as error:
        raise InvalidValueError(
            f"{file} is read by Stable-Baselines3, which is not installed: pip install stable-baselines3"
        ) from error
    with open_file(file) as opened:
        try:
            data, params, _ = load_from_zip_file(opened, device="cpu")
            stored = cast(dict[str, Any], data)
            policy = stored["policy_class"](
                stored["observation_space"],
                stored["action_space"],
                _no_schedule,
                **(stored.get("policy_kwargs") or {}),
            )
            policy.load_state_dict(params["policy"])
        except (ValueError, KeyError, TypeError, RuntimeError) as error:
            raise CheckpointError(f"{file} contains no policy of Stable-Baselines3: {error}") from None
    try:
        return Sb3Agent(task, policy, wrapper)
    except CheckpointError as error:
        raise CheckpointError(f"{file}: {error}") from None


def _no_schedule(_: float) -> float:
    """Dummy learning rate schedule for inference."""
    return 0.0
