"""Policies of Stable-Baselines3 as agents: from a model, or from the file that `model.save` writes."""

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import ACTION_OFFSETS
from drone_env.core.episode import Observation
from drone_env.core.seeds import map_key, next_key, task_key, two_halves
from drone_env.core.tasks import TaskConfig
from drone_env.envs import wrappers
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.forms import to_planes, to_vector
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.files import open_file
from drone_env.planning.from_observation import drone_positions

KEY = task_key("agent/sb3", 1)
AT_ONCE: Mapping[Any, Callable[[Any], Any]] = {
    None: dict,
    wrappers.FlatObservation: to_vector,
    wrappers.OneHotPlanes: to_planes,
}
"""The batched form of this package's wrappers, and of none."""


def open_actions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.bool_]:
    """The environment's `action_masks`, bool[N, 5], from grids uint8[N, H, W] and their telemetry."""
    closed = np.pad(np.isin(grids, [*task.impassable]), ((0, 0), (1, 1), (1, 1)), constant_values=True)
    x, y = drone_positions(task, grids, telemetry).T + 1
    each = np.arange(len(grids))
    # The cell of the drone itself is open, whatever lies below it.
    return np.stack([~closed[each, y + down, x + right] for right, down in ACTION_OFFSETS.values()], axis=1)


class Sb3Agent:
    """Flies by a policy; one trained with masks (MaskablePPO) gets the action mask.

    Args:
        task: The task.
        policy: The policy of a model.
        wrapper: The wrapper of observations in its training; None for none.
        sampled: Sample actions by their probabilities and the agent seed; else take the likeliest.

    Raises:
        CheckpointError: if the policy sees other observations than those of the task behind the wrapper.
        InvalidValueError: if it is recurrent, or to be sampled and has no probabilities.
    """

    def __init__(
        self, task: TaskConfig, policy: Any, wrapper: Callable[[Any], Any] | None = None, sampled: bool = False
    ) -> None:
        env = DroneDeliveryEnv(task)
        self._wrapped: Any = env if wrapper is None else wrapper(env)
        name = "none" if wrapper is None else getattr(wrapper, "__name__", str(wrapper))
        sees, shown = policy.observation_space, self._wrapped.observation_space
        if shown != sees:
            raise CheckpointError(f"this policy sees {sees}, and {task.id!r} behind the wrapper {name} is {shown}")
        if hasattr(policy, "lstm_actor"):
            raise InvalidValueError("a recurrent policy keeps a state: write an agent of your own that hands it on")
        if sampled and not hasattr(policy, "get_distribution"):
            raise InvalidValueError(f"{type(policy).__name__} has no probabilities of actions: leave `sampled` out")
        self._task, self._policy, self._form = task, policy, AT_ONCE.get(wrapper)
        self._masked = "maskable" in type(policy).__module__
        self.stochastic, self.stateless = sampled, not sampled
        policy.set_training_mode(False)
        weights = hashlib.sha256()
        for key, part in policy.state_dict().items():
            weights.update(key.encode() + part.detach().cpu().numpy().tobytes())
        self.config: Mapping[str, object] = {
            "agent": "sb3",
            "version": 1,
            "policy": f"{type(policy).__module__}.{type(policy).__qualname__}",
            "weights": weights.hexdigest()[:16],
            "wrapper": name,
            "sampled": sampled,
        }
        self._keys: Any = np.zeros(1, np.int64)

    def reset(self, seed: int) -> None:
        """Seed the sampling of one flight."""
        self.reset_batch(np.array([seed]))

    def act(self, observation: Observation) -> int:
        """The next action of one drone."""
        return int(self.act_batch(observation["grid"][None], observation["telemetry"][None])[0])

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Seed the sampling of each flight, int64[N]."""
        as_integers: Any = seeds
        self._keys = map_key(KEY, as_integers)

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]."""
        obs, masks = self._obs(grids, telemetry), {}
        if self._masked:
            masks = {"action_masks": open_actions(self._task, grids, telemetry)}
        if not self.stochastic:
            return np.asarray(self._policy.predict(obs, deterministic=True, **masks)[0], np.int64)
        distribution = self._policy.get_distribution(self._policy.obs_to_tensor(obs)[0], **masks)
        shares = distribution.distribution.probs.detach().cpu().numpy().astype(np.float64).cumsum(axis=1)
        self._keys = next_key(self._keys)
        thresholds = two_halves(self._keys)[0] / 2**32 * shares[:, -1]
        return (shares <= np.asarray(thresholds)[:, None]).sum(axis=1)

    def _obs(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Any:
        """The observations of N drones as the policy takes them."""
        if self._form is not None:
            return self._form({"grid": grids, "telemetry": telemetry})
        each = zip(grids, telemetry, strict=True)
        shown: Any = [self._wrapped.observation({"grid": grid, "telemetry": values}) for grid, values in each]
        if isinstance(shown[0], np.ndarray):
            return np.stack(shown)
        return {name: np.stack([one[name] for one in shown]) for name in shown[0]}


def load_policy(file: Path, task: TaskConfig, wrapper: Any, sampled: bool) -> Sb3Agent:
    """The policy in a file that `model.save` wrote, of any algorithm. Reading it runs code from the file.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no policy, or none for the task behind the wrapper.
        InvalidValueError: if Stable-Baselines3 is not installed, or as `Sb3Agent` says.
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
            found = cast(dict[str, Any], data)
            options = {"use_sde": found["use_sde"]} if found.get("use_sde") else {}
            policy = found["policy_class"](
                found["observation_space"],
                found["action_space"],
                _no_rate,
                **options,
                **(found.get("policy_kwargs") or {}),
            )
            policy.load_state_dict(params["policy"])
        except (ValueError, KeyError, TypeError, RuntimeError) as error:
            raise CheckpointError(f"{file} holds no policy of Stable-Baselines3: {error}") from None
    try:
        return Sb3Agent(task, policy, wrapper, sampled)
    except CheckpointError as error:
        raise CheckpointError(f"{file}: {error}") from None


def _no_rate(_: float) -> float:
    """Dummy schedule for inference."""
    return 0.0
