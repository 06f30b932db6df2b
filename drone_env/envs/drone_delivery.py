"""One drone as a `gymnasium.Env`."""

from collections.abc import Callable
from typing import Any, SupportsIndex

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from drone_env.core.actions import N_ACTIONS
from drone_env.core.episode import Episode, EpisodeState, Observation
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.ansi import draw_text
from drone_env.envs.forms import observation_space
from drone_env.envs.rendering import FPS, draw_picture
from drone_env.errors import InvalidValueError
from drone_env.reward_file import chosen_profile

DRAW: dict[str, Callable[[Episode], Any]] = {"ansi": draw_text, "rgb_array": draw_picture}
"""The render modes."""


class DroneDeliveryEnv(gymnasium.Env[Observation, int]):
    """Deliver parcels on a generated city grid.

    Observations are `{"grid": uint8[H, W], "telemetry": float32[5]}`. Cell ids are those of `core.cells.Cell`. The
    telemetry is drone x/width, y/height, battery, target x/width, y/height. A sixth value is the fraction of steps
    left, if the battery does not show it. With pads, seven more values are the one-hot kind of the cell below the
    drone, in the order of `core.tasks.TERRAIN`. Actions: 0 UP, 1 DOWN, 2 LEFT, 3 RIGHT, 4 WAIT. Every ending is part
    of the task and sets `terminated`; `truncated` is always False.

    `info` always contains `seed` (number of the map), `score` (graded, provisional until the end), `action_mask`
    (int8[5], not enforced), `event` and `outcome` (`flying` until the end). `gymnasium.make` adds the optimum
    (`wrappers.WithOptimum`).

    Args:
        task: A task or its name.
        version: The task's version; None for the current one.
        reward_profile: A reward profile, its name, or the path of a TOML file that defines one.
        render_mode: `ansi` (a string), `rgb_array` (uint8[h, w, 3]) or None. `gymnasium.make` also takes `human`: its
            wrapper `HumanRendering` opens a window.

    Raises:
        UnknownNameError: if the task, version or profile does not exist.
        InvalidValueError: if the render mode does not exist.
    """

    metadata: dict[str, Any] = {"render_modes": [*DRAW], "render_fps": FPS}

    def __init__(
        self,
        task: str | TaskConfig = "easy_delivery",
        version: int | None = None,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        render_mode: str | None = None,
    ) -> None:
        self.task = get_task(task, version)
        if render_mode not in (None, *DRAW):
            raise InvalidValueError(f"unknown render_mode {render_mode!r}; allowed: {', '.join(DRAW)}")
        self.render_mode = render_mode
        self.episode = Episode(self.task, chosen_profile(reward_profile))
        self.observation_space = observation_space(self.task)  # type: ignore[assignment]
        self.action_space = spaces.Discrete(N_ACTIONS)  # type: ignore[assignment]

    def reset(
        self, *, seed: SupportsIndex | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode on map `seed`. Without a seed, use the next map of `core.seeds.next_seed`.

        Args:
            seed: In [0, 2^53). If the first reset has no seed, it draws a train map at random.
            options: There are none. A city file or a task of your own has another start, parcels or battery.

        Raises:
            InvalidValueError: if the seed is out of range, or there are options.
        """
        if options:
            raise InvalidValueError(f"reset takes no options, got {list(options)}")
        self.episode.reset(seed)
        super().reset(seed=None if seed is None else self.episode.seed)
        return self.episode.observation(), self._info()

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly one action.

        Raises:
            gymnasium.error.ResetNeeded: before the first reset and after the end of the episode.
            InvalidValueError: if the action is not an integer from 0 to 4.
        """
        if not self.episode.started or self.episode.ended:
            raise ResetNeeded("the episode has not started or has ended: call reset() before step()")
        reward = self.episode.step(action)
        return self.episode.observation(), reward, self.episode.ended, False, self._info()

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """The action mask as bool[5], for `MaskablePPO`."""
        return self.episode.action_mask().astype(np.bool_)

    def get_state(self) -> EpisodeState:
        """A snapshot of the episode for `set_state`, such as the root of a tree search. Immutable, comparable, pickled.

        Raises:
            EpisodeError: before the first reset.
        """
        return self.episode.get_state()

    def set_state(self, state: EpisodeState) -> None:
        """Continue from a snapshot of an episode with the same task and reward profile, also an ended episode's.

        Raises:
            InvalidValueError: if the snapshot has another task or profile; nothing changes.
        """
        self.episode.set_state(state)

    def render(self) -> Any:
        """The episode as a string (`ansi`) or a picture, uint8[h, w, 3] (`rgb_array`).

        Raises:
            gymnasium.error.ResetNeeded: before the first reset.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render mode: pass render_mode='rgb_array' or 'ansi' to make()")
            return None
        if not self.episode.started:
            raise ResetNeeded("no episode to render: call reset() before render()")
        return DRAW[self.render_mode](self.episode)

    def _info(self) -> dict[str, Any]:
        """The same keys with the same types in every step: libraries store them in columns."""
        episode = self.episode
        return {
            "seed": episode.seed,
            "score": episode.score,
            "action_mask": episode.action_mask(),
            "event": episode.event.name.lower(),
            "outcome": episode.outcome.name.lower(),
        }
