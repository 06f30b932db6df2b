"""One episode: its state, and the actions that change it by the `rules`."""

import secrets
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, SupportsIndex

import numpy as np
import numpy.typing as npt

from drone_env.core import rules
from drone_env.core.actions import ENDINGS, MESSAGES, N_ACTIONS, Action, Event, Outcome, check_action
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile, get_reward_profile, interpreted_rewards
from drone_env.core.rules import EFFICIENCY_WEIGHTS, Observation, open_actions, score, score_of, write_telemetry
from drone_env.core.seeds import SPLITS, check_seed, next_seed
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    DISTANCE,
    EVENT,
    NOWHERE,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    interpreted,
    state_size,
    view,
)
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError


class PathStep(NamedTuple):
    """One flown step: the action, and position, event, reward and battery after it."""

    action: Action
    x: int
    y: int
    event: Event
    reward: float
    battery: int


@dataclass(frozen=True)
class EpisodeState:
    """A snapshot of an `Episode`, made by `get_state` and read by `set_state`. Immutable and comparable."""

    task: TaskConfig
    reward_profile: RewardProfile
    seed: int
    grid: bytes
    numbers: bytes
    reward_total: float
    path: tuple[tuple[int, int, int, float, int], ...]
    refused: bool = field(default=False, compare=False)
    """Whether the last step came after the end of the episode."""


class _NoEpisode:
    """The state before the first reset: reading it raises an error."""

    def __getitem__(self, index: object) -> Any:
        raise EpisodeError(NOT_STARTED)


NOT_STARTED = "no episode yet: call reset() first"
_NO_EPISODE: Any = _NoEpisode()


class Episode:
    """A single drone on a single map. Reading the state before the first reset raises `EpisodeError`.

    Args:
        task: A task or its name.
        reward_profile: A reward profile or its name.
        seed: The map to start on; without a seed, call `reset`.
    """

    def __init__(
        self,
        task: str | TaskConfig = "easy_delivery",
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        seed: SupportsIndex | None = None,
    ) -> None:
        self.task = get_task(task)
        self.tables = interpreted(self.task)
        self._choose_rewards(get_reward_profile(reward_profile))
        self._grid_array = np.zeros(self.tables.cells, np.uint8)
        self._state_array = np.zeros(state_size(self.tables), np.uint16)
        self._grid = view(self._grid_array)
        self._state: Buffer = _NO_EPISODE
        self._seed: int | None = None
        self._reward_total = 0.0
        self._refused = False
        self._path: list[tuple[int, int, int, float, int]] = []
        if seed is not None:
            self.reset(seed)

    def reset(self, seed: SupportsIndex | None = None, reward_profile: str | RewardProfile | None = None) -> int:
        """Start map `seed` and return the seed. On an error the current episode does not change.

        Args:
            seed: If None, the next map of `next_seed`; the first map is then drawn at random from the train split.
            reward_profile: The profile from now on; None keeps the current one.
        """
        profile = self.reward_profile if reward_profile is None else get_reward_profile(reward_profile)
        if seed is not None:
            chosen = check_seed(seed)
        elif self._seed is None:
            chosen = secrets.randbelow(SPLITS["train"].stop)
        else:
            chosen = next_seed(self._seed)
        self._seed = chosen
        self._choose_rewards(profile)
        self._state = view(self._state_array)
        rules.reset(self.tables, self._grid, self._state, chosen)
        self._reward_total = 0.0
        self._refused = False
        self._path = []
        return chosen

    def step(self, action: SupportsIndex) -> float:
        """Fly one action and return its reward. After the end it returns 0, changes nothing, and sets `message`.

        Raises:
            InvalidValueError: if the action is not an integer from 0 to 4; the state does not change.
            EpisodeError: before the first reset.
        """
        number = int(action) if isinstance(action, Action) else check_action(action)
        state = self._state
        if state[OUTCOME]:
            self._refused = True
            return 0.0
        reward = rules.step(self.tables, self._rewards, self._grid, state, number)
        self._reward_total += reward
        self._path.append((number, state[CELL], state[EVENT], reward, state[BATTERY]))
        return reward

    def fly(self, actions: Iterable[SupportsIndex]) -> "Episode":
        """Fly actions in order and return the episode. Each action is requested after the previous one was flown."""
        for action in actions:
            self.step(action)
        return self

    def copy(self) -> "Episode":
        """An independent copy."""
        copied = Episode.__new__(type(self))
        vars(copied).update(vars(self))
        copied._grid_array, copied._state_array = self._grid_array.copy(), self._state_array.copy()
        copied._grid = view(copied._grid_array)
        copied._state = view(copied._state_array) if self.started else _NO_EPISODE
        copied._path = self._path.copy()
        return copied

    def waited_out(self) -> "Episode":
        """A copy that waits until its end."""
        return self.copy().fly([Action.WAIT] * (self.task.max_steps - self.steps))

    @property
    def seed(self) -> int:
        """The seed of the map."""
        if self._seed is None:
            raise EpisodeError(NOT_STARTED)
        return self._seed

    @property
    def started(self) -> bool:
        """Whether there has been a reset."""
        return self._seed is not None

    @property
    def ended(self) -> bool:
        """Whether the episode is over."""
        return self._state[OUTCOME] != Outcome.FLYING

    @property
    def outcome(self) -> Outcome:
        """The outcome so far."""
        return Outcome(self._state[OUTCOME])

    @property
    def success(self) -> bool:
        """Whether every parcel has been delivered."""
        return self._state[OUTCOME] == Outcome.DELIVERED

    @property
    def event(self) -> Event:
        """The event of the last step."""
        return Event(self._state[EVENT])

    @property
    def steps(self) -> int:
        """Steps flown."""
        return self._state[STEPS]

    @property
    def battery_units(self) -> int:
        """Battery units left."""
        return self._state[BATTERY]

    @property
    def battery(self) -> float:
        """Share of the battery left, 0 to 1."""
        return self._state[BATTERY] / self.tables.capacity

    @property
    def deliveries_done(self) -> int:
        """Parcels delivered."""
        return self._state[DELIVERIES_DONE]

    @property
    def cell(self) -> int:
        """Number of the drone's cell: y * width + x."""
        return self._state[CELL]

    @property
    def position(self) -> tuple[int, int]:
        """(x, y) of the drone."""
        return self._xy(self._state[CELL])

    @property
    def target(self) -> tuple[int, int] | None:
        """(x, y) of the current target, None when nothing is left."""
        return None if self._state[TARGET] == NOWHERE else self._xy(self._state[TARGET])

    @property
    def distance_to_target(self) -> int | None:
        """Manhattan distance to the current target in cells, None when nothing is left."""
        return None if self._state[TARGET] == NOWHERE else self._state[DISTANCE]

    @property
    def parcels(self) -> list[tuple[int, int, bool]]:
        """(x, y, delivered) of each parcel, by its index."""
        entries = self._state[PARCELS:].tolist()
        return [(*self._xy(cell % DELIVERED_FLAG), cell >= DELIVERED_FLAG) for cell in entries]

    @property
    def under(self) -> int:
        """The kind of the cell below the drone."""
        return self._state[UNDER]

    @property
    def score(self) -> float:
        """The graded score, 0.01 to 0.99: provisional until the episode has ended."""
        return score(self.tables, self._state)

    @property
    def efficiency(self) -> float:
        """The efficiency shown to people, 0 to 100. It is not the score."""
        return sum(w * part for w, part in zip(EFFICIENCY_WEIGHTS.values(), self.efficiency_shares, strict=True))

    @property
    def efficiency_shares(self) -> tuple[float, float, float]:
        """Each part of the efficiency, 0 to 1, in the order of `rules.EFFICIENCY_WEIGHTS`."""
        return self.deliveries_done / self.task.deliveries, self.battery, 1 - self.steps / self.task.max_steps

    @property
    def score_parts(self) -> tuple[float, float, float]:
        """What each of these parts adds to the score. The first contains the lowest score, which is never lost."""
        done, units, steps = self.deliveries_done, self.battery_units, self.task.max_steps
        parcels, charged = (score_of(self.tables, done, left, steps) for left in (0, units))
        return parcels, charged - parcels, self.score - charged

    @property
    def reward_last(self) -> float:
        """The reward of the last step; 0 after the end."""
        return self._path[-1][3] if self._path and not self._refused else 0.0

    @property
    def reward_total(self) -> float:
        """The undiscounted sum of all rewards."""
        return self._reward_total

    @property
    def path(self) -> list[PathStep]:
        """All steps flown, in order."""
        return [self._path_step(entry) for entry in self._path]

    @property
    def last_step(self) -> PathStep | None:
        """The last entry of `path`, None before the first step."""
        return self._path_step(self._path[-1]) if self._path else None

    @property
    def actions(self) -> list[int]:
        """The actions flown, in order."""
        return [entry[0] for entry in self._path]

    @property
    def rewards(self) -> list[float]:
        """The reward of each step, in order."""
        return [entry[3] for entry in self._path]

    @property
    def message(self) -> str:
        """The last event, in words."""
        if self._seed is None:
            return "No episode yet: reset to start one."
        if self._refused:
            return f"Nothing done: the episode has ended ({self.outcome.name.lower()}). Reset to fly again."
        return (
            MESSAGES[self.event].format(done=self.deliveries_done, total=self.task.deliveries) + ENDINGS[self.outcome]
        )

    def counted_score(self) -> float:
        """The score to report. An unfinished episode scores as if it waited to its end."""
        return self.waited_out().score

    def observation(self) -> Observation:
        """The current observation, as new arrays."""
        telemetry = np.zeros(self.tables.telemetry_size, np.float32)
        write_telemetry(self.tables, self._state, view(telemetry))
        return {"grid": self.grid(), "telemetry": telemetry}

    def grid(self) -> npt.NDArray[np.uint8]:
        """The cell ids as the drone sees them: a copy, uint8[height, width]."""
        if not self.started:
            raise EpisodeError(NOT_STARTED)
        return np.array(np.reshape(self._grid_array, (self.tables.height, self.tables.width)))

    def action_mask(self) -> npt.NDArray[np.int8]:
        """int8[5]: 0 for each action that would bump into a wall or an impassable cell."""
        mask = open_actions(self.tables, self._grid, self._state)
        return np.array([mask >> 8 * action & 1 for action in range(N_ACTIONS)], np.int8)

    def get_state(self) -> EpisodeState:
        """A snapshot for `set_state`."""
        return EpisodeState(
            task=self.task,
            reward_profile=self.reward_profile,
            seed=self.seed,
            grid=self._grid_array.tobytes(),
            numbers=self._state_array.tobytes(),
            reward_total=self._reward_total,
            refused=self._refused,
            path=tuple(self._path),
        )

    def set_state(self, state: EpisodeState) -> None:
        """Restore a snapshot of an episode with the same task and reward profile.

        Raises:
            InvalidValueError: if the snapshot has another task or profile; the state does not change.
        """
        if state.task != self.task or state.reward_profile != self.reward_profile:
            raise InvalidValueError(
                f"the snapshot is of {state.task.id} (rules {state.task.digest}, rewards {state.reward_profile.id}), "
                f"not of {self.task.id} (rules {self.task.digest}, rewards {self.reward_profile.id})"
            )
        self._seed = state.seed
        self._state = view(self._state_array)
        self._grid_array[:] = np.frombuffer(state.grid, np.uint8)
        self._state_array[:] = np.frombuffer(state.numbers, np.uint16)
        self._reward_total = state.reward_total
        self._refused = state.refused
        self._path = list(state.path)

    def __getstate__(self) -> tuple[TaskConfig, RewardProfile, EpisodeState | None]:
        return self.task, self.reward_profile, self.get_state() if self.started else None

    def __setstate__(self, state: tuple[TaskConfig, RewardProfile, EpisodeState | None]) -> None:
        task, reward_profile, snapshot = state
        Episode.__init__(self, task, reward_profile)
        if snapshot is not None:
            self.set_state(snapshot)

    def _choose_rewards(self, profile: RewardProfile) -> None:
        self.reward_profile = profile
        self._rewards = interpreted_rewards(self.task, profile)

    def _path_step(self, entry: tuple[int, int, int, float, int]) -> PathStep:
        action, cell, event, reward, battery = entry
        return PathStep(Action(action), *self._xy(cell), Event(event), reward, battery)

    def _xy(self, cell: int) -> tuple[int, int]:
        return self.tables.columns[cell], self.tables.rows[cell]


Act = Callable[[Observation], SupportsIndex]
"""The type of an agent's `act`."""


def choices(episode: Episode, act: Act) -> Iterator[SupportsIndex]:
    """Yield actions until the episode ends. The caller must fly each action before it requests the next."""
    while not episode.ended:
        yield act(episode.observation())


def rollout(episode: Episode, act: Act) -> Episode:
    """Fly an episode to its end and return it."""
    return episode.fly(choices(episode, act))
