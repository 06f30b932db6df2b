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
from drone_env.envs.registry import check_gym_id
from drone_env.envs.spaces import observation_space
from drone_env.errors import EpisodeError, InvalidValueError

Observations = dict[str, npt.NDArray[Any]]


class DroneDeliveryVectorEnv(VectorEnv[Observations, npt.NDArray[Any], npt.NDArray[Any]]):
    """`num_envs` drones, each on a map of its own, with Gymnasium's interface of vector environments.

    Observations: `{"grid": uint8[N, H, W], "telemetry": float32[N, telemetry_size]}`, as of a single one. Actions: N
    integers from 0 to 4. Rewards: float64[N].

    `info` of a step holds `action_mask` (int8[N, 5]) and, where episodes ended, `final_info`: a dictionary of arrays
    over all N with `score`, `steps`, `deliveries` and `seed`, each with its mask (`_score`, ...). In `SAME_STEP` mode
    `final_obs` holds the observations that ended those episodes. Each is masked as Gymnasium does it.

    Args:
        num_envs: N, at least 1.
        task: A task or its name.
        version: The task's version, None for the current one.
        reward_profile: A reward profile or its name.
        autoreset_mode: `NEXT_STEP` or `SAME_STEP`, as `AutoresetMode` or its value.
        num_threads: How many threads share a step.
        copy: Whether observations, rewards and masks are copies that stay as they are; otherwise they are the live
            buffers, which the next step overwrites and nobody else can write to.
        render_mode: None; a batch has no picture.
        gym_id: The id that the environment is made under: it must be the task's own.

    Raises:
        UnknownNameError: if the task, version or profile does not exist.
        InvalidValueError: if a number, the mode, the render mode or the id is not allowed.
    """

    def __init__(
        self,
        num_envs: SupportsIndex = 1,
        task: str | TaskConfig = "easy_delivery",
        version: int | None = None,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        num_threads: SupportsIndex = 1,
        copy: bool = True,
        render_mode: str | None = None,
        gym_id: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise InvalidValueError(f"a batch has no pictures: render_mode must be None, got {render_mode!r}")
        allowed = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]
        modes = [mode for mode in allowed if autoreset_mode in (mode, mode.value, mode.name)]
        if not modes:
            raise InvalidValueError(f"autoreset_mode must be NEXT_STEP or SAME_STEP, got {autoreset_mode!r}")
        self.task = get_task(task, version)
        check_gym_id(gym_id, self.task)
        self.metadata = {"render_modes": [], "autoreset_mode": modes[0]}
        self.render_mode = None
        self.copy = copy
        self.batch = Batch(
            self.task, num_envs, reward_profile, same_step=modes[0] is AutoresetMode.SAME_STEP, num_threads=num_threads
        )
        self.num_envs = self.batch.num_envs
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = spaces.Discrete(N_ACTIONS)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._prepare()

    def _prepare(self) -> None:
        """What every step hands out, and nobody is to write to."""
        batch = self.batch
        self._truncations = _read_only(np.zeros(self.num_envs, np.bool_))
        self._everyone = _read_only(np.ones(self.num_envs, np.bool_))
        self._live = {"grid": _read_only(batch.grids), "telemetry": _read_only(batch.telemetry)}
        self._live_outcome = (_read_only(batch.rewards), _read_only(batch.terminated), self._truncations)
        self._live_masks = _read_only(batch.action_masks)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._prepare()  # a copy's views have to show its own batch

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin all episodes, or those that `options["reset_mask"]` names.

        Args:
            seed: A list of N seeds (None in a place: that episode's own next map), or one seed s for the maps s,
                s + 1, ..., s + N - 1. None: each episode's own next map; the very first ones follow each other from a
                train map drawn at random.
            options: May hold `reset_mask`, bool[N] with at least one True: the other episodes fly on.

        Raises:
            InvalidValueError: if a seed, a mask or an option is not allowed; nothing is changed.
            EpisodeError: if a mask leaves out an episode that has never begun.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise InvalidValueError(f"unknown reset options {list(options)}; allowed: reset_mask")
        if mask is not None:
            mask = np.asarray(mask)
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
                raise InvalidValueError(f"reset_mask must be bool[{self.num_envs}] with at least one True")
            if not self.batch.started and not mask.all():
                raise EpisodeError("no episode has begun yet: the first reset() must begin all of them")
        self.batch.reset(self._seeds(seed), mask)
        return self._observations(), self._info() | {"seed": self.batch.seeds.copy(), "_seed": self._everyone}

    def step(
        self, actions: npt.NDArray[Any]
    ) -> tuple[Observations, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Fly one action in each episode.

        Raises:
            InvalidValueError: if the actions are not N integers from 0 to 4; nothing is flown.
            EpisodeError: before the first reset.
        """
        self.batch.step(actions)
        info = self._info()
        ended = self.batch.ended
        if len(ended):
            self._add_finals(info, ended)
        outcome = self._live_outcome
        if self.copy:
            outcome = tuple(array.copy() for array in outcome)
        rewards, terminations, truncations = outcome
        return self._observations(), rewards, terminations, truncations, info

    def _seeds(self, seed: int | Sequence[int | None] | None) -> npt.NDArray[np.int64]:
        if not self.batch.started:
            first = int(np.random.default_rng().integers(SPLITS["train"].stop - self.num_envs))
            following = np.arange(first, first + self.num_envs)
        else:
            flown: Any = self.batch.seeds  # the walk is plain integer arithmetic, so it takes arrays as well
            following = np.asarray(next_seed(flown))
        if seed is None:
            return following
        given: Any = seed
        if isinstance(seed, int) or np.ndim(given) == 0:
            start = check_seed(given)
            check_seed(start + self.num_envs - 1)
            return np.arange(start, start + self.num_envs)
        if len(seed) != self.num_envs:
            raise InvalidValueError(f"seed must be one seed or {self.num_envs}, got {len(seed)}")
        return np.array([own if s is None else check_seed(s) for s, own in zip(seed, following, strict=True)], np.int64)

    def _observations(self) -> Observations:
        return {name: array.copy() if self.copy else array for name, array in self._live.items()}

    def _info(self) -> dict[str, Any]:
        masks = self.batch.copy_action_masks() if self.copy else self._live_masks
        return {"action_mask": masks, "_action_mask": self._everyone}

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
    """A view of an array that cannot be written to."""
    view = array.view()
    view.setflags(write=False)
    return view
