"""Many drones as one `stable_baselines3.common.vec_env.VecEnv`, stepped by compiled code."""

import time
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from drone_env.core.actions import N_ACTIONS
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.tasks import TaskConfig
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.vector import DroneDeliveryVectorEnv
from drone_env.envs.wrappers import FlatObservation, OneHotPlanes, StopObservation
from drone_env.errors import InvalidValueError, UnknownNameError

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices
except ModuleNotFoundError as error:
    raise ImportError("drone_env.envs.sb3 needs Stable-Baselines3: pip install stable-baselines3") from error

Observations = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]

FORMS = {"dict": OneHotPlanes, "flat": FlatObservation, "stops": StopObservation}
"""The forms of the observation, and the wrapper of a single drone with the same form."""


class DroneDeliveryVecEnv(VecEnv):
    """`num_envs` drones, each on its own map, with the interface of Stable-Baselines3.

    Actions are N integers from 0 to 4, rewards are float32[N]. All returned arrays are copies.

    When an episode ends, the next one starts in the same step, on the map that `seeds.next_seed` returns. The info of
    the ended episode contains `terminal_observation`, `TimeLimit.truncated` (always False), `episode` (`r` sum of
    rewards, `l` steps, `t` seconds since the environment was created), `score`, `deliveries`, `seed` and `is_success`.
    All other infos are empty. `reset_infos` contains the `seed` of each drone's map.

    Attributes are common to all drones: `set_attr` applies to all of them.

    Args:
        task: A task or its name.
        num_envs: N, at least 1.
        version: The task's version; None for the current one.
        reward_profile: A reward profile, its name, or the path of a TOML file that defines one.
        observation: `dict` for `{"grid": uint8[N, kinds, H, W], "telemetry": float32[N, n]}`, the grid as one-hot
            planes, for `MultiInputPolicy`; `flat` for float32[N, kinds * H * W + n], the planes and then the
            telemetry, for `MlpPolicy`; `stops` for `forms.StopEntries`, for a features extractor with an embedding
            table. n is the task's `telemetry_size`: 5, 6 or 13.

    Raises:
        UnknownNameError: if the task, version, profile or form of the observation does not exist.
        InvalidValueError: if a number is not an integer of at least 1.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        num_envs: SupportsIndex,
        version: int | None = None,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        observation: str = "dict",
    ) -> None:
        if observation not in list(FORMS):
            raise UnknownNameError("observation form", observation, FORMS)
        self._vector = DroneDeliveryVectorEnv(
            num_envs, task, version, reward_profile, AutoresetMode.SAME_STEP, copy=False
        )
        self.task = self._vector.task
        self.batch = self._vector.batch
        self.observation = observation
        self.render_mode = None  # the base class reads it through get_attr()
        single = FORMS[observation](DroneDeliveryEnv(self.task))
        self._to_form: Any = single.func
        super().__init__(self.batch.num_envs, single.observation_space, spaces.Discrete(N_ACTIONS))
        self._actions: Any = None
        self._returns = np.zeros(self.num_envs)
        self._start = time.perf_counter()

    def reset(self) -> Observations:
        """Start all episodes, on the maps that `seed` chose or else on each drone's next map.

        Raises:
            InvalidValueError: if a seed is not in [0, 2^53).
        """
        self._vector.reset(seed=self._seeds)
        self._reset_seeds()
        self._returns[:] = 0.0
        self.reset_infos = [{"seed": seed} for seed in self.batch.seeds.tolist()]
        return self._observations(self.batch.grids, self.batch.telemetry)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Store the actions, N integers from 0 to 4, for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Fly one action in each episode: observations, rewards (float32[N]), dones (bool[N]) and N infos.

        Raises:
            InvalidValueError: if the actions are not N integers from 0 to 4; nothing changes.
            EpisodeError: before the first reset.
        """
        batch = self.batch
        batch.step(self._actions)
        self._returns += batch.rewards
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if len(batch.ended):
            self._add_finals(infos)
        observations = self._observations(batch.grids, batch.telemetry)
        return observations, batch.rewards.astype(np.float32), batch.terminated.copy(), infos

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """bool[N, 5]: False for each action that would bump. Not enforced."""
        return self.batch.action_masks.astype(np.bool_)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute, repeated for each drone in `indices` (None for all).

        Raises:
            AttributeError: if there is no such attribute.
        """
        value = getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set the attribute for all drones.

        Raises:
            InvalidValueError: if `indices` does not include all drones.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise InvalidValueError(
                f"attributes apply to all {self.num_envs} drones: call set_attr({attr_name!r}, value) without indices"
            )
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> Any:
        """Call a method of all drones, such as `action_masks`, and return the parts of its result for `indices`."""
        results = getattr(self, method_name)(*method_args, **method_kwargs)
        return [results[i] for i in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """True for SB3's `Monitor`, because infos contain `episode`; else False."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def close(self) -> None:
        """There is nothing to close."""

    def _observations(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Observations:
        """New observations from uint8[n, H, W] and float32[n, telemetry_size]."""
        return self._to_form({"grid": grids, "telemetry": telemetry.copy()})

    def _add_finals(self, infos: list[dict[str, Any]]) -> None:
        """Fill in the infos of the episodes that ended in the last step."""
        batch, ended = self.batch, self.batch.ended
        last = self._observations(batch.final_grids, batch.final_telemetry)
        seconds = time.perf_counter() - self._start
        finals = {name: values.tolist() for name, values in batch.finals().items()}
        returns, following = self._returns[ended].tolist(), batch.seeds[ended].tolist()
        for k, i in enumerate(ended.tolist()):
            infos[i] = {
                "terminal_observation": {name: values[k] for name, values in last.items()}
                if isinstance(last, dict)
                else last[k],
                "TimeLimit.truncated": False,
                "episode": {"r": returns[k], "l": finals["steps"][k], "t": seconds},
                "score": finals["score"][k],
                "deliveries": finals["deliveries"][k],
                "seed": finals["seed"][k],
                "is_success": finals["deliveries"][k] == self.task.deliveries,
            }
            self.reset_infos[i] = {"seed": following[k]}
        self._returns[ended] = 0.0
