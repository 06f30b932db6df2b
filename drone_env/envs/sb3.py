"""Many drones as one `stable_baselines3.common.vec_env.VecEnv`, stepped by compiled code."""

import time
from collections.abc import Sequence
from typing import Any, SupportsIndex, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from drone_env.core.actions import N_ACTIONS
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.seeds import check_seed
from drone_env.core.tasks import TaskConfig
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.forms import to_planes, to_vector
from drone_env.envs.rendering import FPS
from drone_env.envs.vector import DroneDeliveryVectorEnv
from drone_env.envs.wrappers import FlatObservation, OneHotPlanes
from drone_env.errors import InvalidValueError, UnknownNameError

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices
except ModuleNotFoundError as error:
    raise ImportError("drone_env.envs.sb3 needs Stable-Baselines3: pip install stable-baselines3") from error

Observations = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]

FORMS = {"dict": OneHotPlanes, "flat": FlatObservation}
"""The forms of the observation, with the wrapper that gives the same one for a single drone."""


class DroneDeliveryVecEnv(VecEnv):
    """`num_envs` drones, each on a map of its own, as Stable-Baselines3 steps them.

    Actions: N integers from 0 to 4. Rewards: float32[N]. Whatever a call returns is a copy and stays as it is.

    An episode that ends is followed at once by the one on the map that `seeds.next_seed` names. Its info then holds
    `terminal_observation`, `TimeLimit.truncated` (False: every ending is part of the task), `episode` (`r` the sum of
    its rewards, `l` its steps, `t` seconds since this object was made), `score`, `deliveries`, `seed` and
    `is_success`; all other infos are empty. `reset_infos` holds the `seed` that each drone flies.

    The drones share all attributes: `get_attr` gives each the same, and `set_attr` takes no part of them.

    Args:
        task: A task or its name.
        num_envs: N, at least 1.
        version: The task's version, None for the current one.
        reward_profile: A reward profile, its name, or that of a TOML file with one (.toml).
        num_threads: How many threads share a step.
        observation: `dict` for `{"grid": uint8[N, kinds, H, W], "telemetry": float32[N, 5]}`, the grid as one-hot
            planes, for `MultiInputPolicy`; `flat` for float32[N, kinds * H * W + 5], the planes and then the
            telemetry, for `MlpPolicy`. (The task's `telemetry_size` in place of 5 where that is 6 or 13.)
        render_mode: `rgb_array`, for pictures of every episode, or None.

    Raises:
        UnknownNameError: if the task, version, profile or form of the observation does not exist.
        InvalidValueError: if a number is not an integer or below 1, or the render mode does not exist.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        num_envs: SupportsIndex,
        version: int | None = None,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        num_threads: SupportsIndex = 1,
        observation: str = "dict",
        render_mode: str | None = None,
    ) -> None:
        if observation not in list(FORMS):
            raise UnknownNameError("observation form", observation, FORMS)
        self._vector = DroneDeliveryVectorEnv(
            num_envs, task, version, reward_profile, AutoresetMode.SAME_STEP, num_threads, False, render_mode
        )
        self.task = self._vector.task
        self.batch = self._vector.batch
        self.observation = observation
        self.render_mode = render_mode  # the base class asks for it through get_attr()
        single = FORMS[observation](DroneDeliveryEnv(self.task))
        super().__init__(self.batch.num_envs, single.observation_space, spaces.Discrete(N_ACTIONS))
        cast(dict[str, Any], self.metadata)["render_fps"] = FPS
        self._actions: Any = None
        self._returns = np.zeros(self.num_envs)
        self._start = time.perf_counter()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Choose the maps seed, seed + 1, ..., seed + N - 1 for the next reset; None draws the first at random.

        Raises:
            InvalidValueError: if one of them is not in [0, 2^53); nothing is changed.
        """
        if seed is not None:
            check_seed(check_seed(seed) + self.num_envs - 1)
        return super().seed(seed)

    def reset(self) -> Observations:
        """Begin all episodes: on the maps that `seed` chose, else each on its own next map.

        The very first maps, if `seed` did not choose them, follow each other from a train map drawn at random.
        """
        self._vector.reset(seed=self._seeds)
        self._reset_seeds()
        self._returns[:] = 0.0
        self.reset_infos = [{"seed": seed} for seed in self.batch.seeds.tolist()]
        return self._observations(self.batch.grids, self.batch.telemetry)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take over the actions, N integers from 0 to 4, for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Fly one action in each episode: observations, rewards (float32[N]), dones (bool[N]) and N infos.

        Raises:
            InvalidValueError: if the actions are not N integers from 0 to 4; nothing is flown.
            EpisodeError: before the first reset.
        """
        batch = self.batch
        self._vector.fly(self._actions)
        self._returns += batch.rewards
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if len(batch.ended):
            self._add_finals(infos)
        observations = self._observations(batch.grids, batch.telemetry)
        return observations, batch.rewards.astype(np.float32), batch.terminated.copy(), infos

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """bool[N, 5]: False for each action that would bump. Advice, never enforced."""
        return self.batch.action_masks.astype(np.bool_)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute, once for each of the drones in `indices` (None: for all).

        Raises:
            AttributeError: if there is no such attribute.
        """
        value = getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set the attribute for all drones.

        Raises:
            InvalidValueError: if `indices` leaves out some.
        """
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise InvalidValueError(f"all {self.num_envs} drones share their attributes, set {attr_name!r} for all")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> Any:
        """`action_masks`, the one method that a single drone has here: a list of bool[5].

        Raises:
            UnknownNameError: if another method is asked for.
            TypeError: if arguments are passed to it.
        """
        if method_name != "action_masks":
            raise UnknownNameError("method of a single drone", method_name, ["action_masks"])
        masks = self.action_masks(*method_args, **method_kwargs)
        return [masks[i] for i in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Whether the drones do what this wrapper does: True for SB3's `Monitor`, as infos hold `episode`."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """A picture of each episode, uint8[360, width, 3]; None for each without a render mode.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        return self._vector.render() or [None] * self.num_envs

    def close(self) -> None:
        """Nothing is held open."""

    def _observations(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Observations:
        """The observations of n drones, from uint8[n, H, W] and float32[n, telemetry_size]; new arrays."""
        if self.observation == "flat":
            return to_vector({"grid": grids, "telemetry": telemetry})
        return to_planes({"grid": grids, "telemetry": telemetry.copy()})

    def _add_finals(self, infos: list[dict[str, Any]]) -> None:
        """Fill the infos of the episodes that the last step ended."""
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
