"""Many drones as one `gymnasium.vector.VectorEnv`, stepped by compiled code."""

from collections.abc import Sequence
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.seeds import SPLITS, check_seed, next_seed
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.forms import observation_space
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.reward_file import chosen_profile

Observations = dict[str, npt.NDArray[Any]]


class DroneDeliveryVectorEnv(VectorEnv[Observations, npt.NDArray[Any], npt.NDArray[Any]]):
    """`num_envs` drones, each on its own map.

    Observations are `{"grid": uint8[N, H, W], "telemetry": float32[N, telemetry_size]}`, actions are N integers from 0
    to 4, rewards are float64[N].

    `info` contains `action_mask` (int8[N, 5]) and `seed` (int64[N], the maps). When episodes end, it also contains
    `final_info`, a dictionary of arrays over all N with `score`, `steps`, `deliveries` and `seed`, and in `SAME_STEP`
    mode `final_obs`, the last observations. Masks follow Gymnasium's convention (`_seed`, ...).

    Args:
        num_envs: N, at least 1.
        task: A task or its name.
        version: The task's version; None for the current one.
        reward_profile: A reward profile, its name, or the path of a TOML file that defines one. `aligned` shapes with a
            discount of 0.99; for a learner with another, `core.rewards.profile_for_discount` makes the profile.
        autoreset_mode: When the next episode starts: at the `NEXT_STEP`, in the `SAME_STEP`, or, if `DISABLED`, by
            a `reset` with a mask. An `AutoresetMode`, its name or its value.
        copy: If True, observations, rewards and masks are copies. If False, they are read-only views of the live
            buffers, which the next step overwrites.
        max_episode_steps: None, or a limit that no episode reaches before its end: nothing is truncated.

    Raises:
        UnknownNameError: if the task, version or profile does not exist.
        InvalidValueError: if a number or a mode is not allowed.
    """

    def __init__(
        self,
        num_envs: SupportsIndex = 1,
        task: str | TaskConfig = "easy_delivery",
        version: int | None = None,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        max_episode_steps: int | None = None,
    ) -> None:
        modes = [mode for mode in AutoresetMode if autoreset_mode in (mode, mode.value, mode.name)]
        if not modes:
            allowed = ", ".join(AutoresetMode.__members__)
            raise InvalidValueError(f"autoreset_mode must be one of {allowed}; got {autoreset_mode!r}")
        self.autoreset_mode = modes[0]
        self.task = get_task(task, version)
        if max_episode_steps is not None and max_episode_steps < self.task.max_steps:
            raise InvalidValueError(
                f"max_episode_steps must be at least {self.task.max_steps}, the steps of {self.task.id!r}, got "
                f"{max_episode_steps}: register a task with fewer max_steps, or choose vectorization_mode='sync'"
            )
        self.metadata = {"autoreset_mode": self.autoreset_mode}
        self.copy = copy
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        self.batch = Batch(self.task, num_envs, chosen_profile(reward_profile), same_step)
        self.num_envs = self.batch.num_envs
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = spaces.Discrete(N_ACTIONS)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._prepare()

    def _prepare(self) -> None:
        """Make the read-only views that steps return."""
        batch = self.batch
        self._truncations = _read_only(np.zeros(self.num_envs, np.bool_))
        self._everyone = _read_only(np.ones(self.num_envs, np.bool_))
        self._live = {"grid": _read_only(batch.grids), "telemetry": _read_only(batch.telemetry)}
        self._live_results = (_read_only(batch.rewards), _read_only(batch.terminated), self._truncations)
        self._live_masks, self._live_seeds = _read_only(batch.action_masks), _read_only(batch.seeds)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # views of the copied batch

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Start all episodes, or those that `options["reset_mask"]` selects.

        Args:
            seed: A list of N seeds (None for an episode's next map), or one seed s for the maps s, s + 1, ...,
                s + N - 1. None: each episode's next map. The first maps are consecutive, from a random train map on.
            options: May contain `reset_mask`, bool[N] with at least one True; other episodes continue. The mask is
                then also the mask of `info` (`_seed`, ...).

        Raises:
            InvalidValueError: if a seed, a mask or an option is not allowed; nothing changes.
            EpisodeError: if the mask excludes an episode that has never started.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise InvalidValueError(f"unknown reset options {list(options)}; allowed: reset_mask")
        if mask is not None:
            mask = np.array(mask)  # a copy: it may be the live `terminated`, which the reset changes
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
                raise InvalidValueError(f"reset_mask must be bool[{self.num_envs}] with at least one True")
            if not self.batch.started and not mask.all():
                raise EpisodeError("no episode has started: the first reset() must start all of them")
        self.batch.reset(self._seeds(seed), mask)
        return self._observations(), self._info(self._everyone if mask is None else mask)

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[Observations, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Fly one action in each episode.

        Raises:
            InvalidValueError: if the actions are not N integers from 0 to 4; nothing changes.
            EpisodeError: before the first reset, and in `DISABLED` mode if an episode has ended; nothing changes.
        """
        batch = self.batch
        if self.autoreset_mode is AutoresetMode.DISABLED and batch.terminated.any():
            over = np.flatnonzero(batch.terminated)
            raise EpisodeError(
                f"{len(over)} episodes have ended (the first is {over[0]}) and autoreset_mode is DISABLED: "
                'call reset(options={"reset_mask": terminations}) before step()'
            )
        batch.step(actions)
        info = self._info(self._everyone)
        ended = batch.ended
        if len(ended):
            self._add_finals(info, ended)
        if not self.copy:
            return self._observations(), *self._live_results, info
        results = batch.rewards.copy(), batch.terminated.copy(), self._truncations.copy()
        return self._observations(), *results, info

    def _seeds(self, seed: int | Sequence[int | None] | None) -> npt.NDArray[np.int64]:
        if not self.batch.started:
            first = int(np.random.default_rng().integers(SPLITS["train"].stop - self.num_envs))
            following = np.arange(first, first + self.num_envs)
        else:
            current: Any = self.batch.seeds  # `next_seed` is integer arithmetic, so it also takes arrays
            following = np.asarray(next_seed(current))
        if seed is None:
            return following
        given: Any = seed
        if isinstance(seed, int) or np.ndim(given) == 0:
            start = check_seed(given)
            check_seed(start + self.num_envs - 1)
            return np.arange(start, start + self.num_envs)
        if len(seed) != self.num_envs:
            raise InvalidValueError(f"seed must be one seed or {self.num_envs}, got {len(seed)}")
        return np.array([n if s is None else check_seed(s) for s, n in zip(seed, following, strict=True)], np.int64)

    def _observations(self) -> Observations:
        if not self.copy:
            return self._live.copy()
        return {"grid": self.batch.grids.copy(), "telemetry": self.batch.telemetry.copy()}

    def _info(self, mask: npt.NDArray[np.bool_]) -> dict[str, Any]:
        if not self.copy:
            return {"action_mask": self._live_masks, "_action_mask": mask, "seed": self._live_seeds, "_seed": mask}
        masks, seeds = self.batch.copy_action_masks(), self.batch.seeds.copy()
        return {"action_mask": masks, "_action_mask": mask, "seed": seeds, "_seed": mask}

    def _add_finals(self, info: dict[str, Any], ended: npt.NDArray[np.int64]) -> None:
        mask = np.zeros(self.num_envs, np.bool_)
        mask[ended] = True
        final_info: dict[str, Any] = {}
        for name, values in self.batch.finals().items():
            column = np.zeros(self.num_envs, values.dtype)
            column[ended] = values
            final_info[name] = column
            final_info[f"_{name}"] = mask
        info["final_info"] = final_info
        info["_final_info"] = mask
        if self.batch.same_step:
            grids, telemetry = self.batch.final_grids.copy(), self.batch.final_telemetry.copy()
            final_obs = np.full(self.num_envs, None, object)
            final_obs[ended] = [{"grid": grid, "telemetry": row} for grid, row in zip(grids, telemetry, strict=True)]
            info["final_obs"] = final_obs
            info["_final_obs"] = mask


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A read-only view of an array."""
    view = array.view()
    view.setflags(write=False)
    return view
