"""N episodes of one task, stepped together: the compiled functions of `rules` in one loop over the episodes.

The next step overwrites every buffer of a `Batch`, so copy arrays that you need later.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, SupportsIndex

import numpy as np
import numpy.typing as npt

from drone_env.core import compiled
from drone_env.core.actions import ALLOWED_ACTIONS, FLYING, N_ACTIONS, Event, integer
from drone_env.core.compile_cache import print_before_compiling
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile, Rewards, get_reward_profile, tabulate_rewards
from drone_env.core.rules import open_actions, score, write_own_telemetry, write_target_telemetry, write_telemetry
from drone_env.core.rules import reset as reset_episode
from drone_env.core.rules import step as step_episode
from drone_env.core.seeds import N_SEEDS, next_seed
from drone_env.core.tables import DELIVERIES_DONE, EVENT, OUTCOME, STEPS, Tables, state_size, tabulate
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError

DELIVERED = int(Event.DELIVERY)
ACTION_BITS = 7
"""A mask that does not change actions from 0 to 4. It shows the compiler that actions are not negative."""


class Buffers(NamedTuple):
    """The arrays of a batch of N episodes, for kernels."""

    grids: Any
    """uint8[N, cells]"""
    states: Any
    """uint16[N, state size]"""
    seeds: Any
    """int64[N], the map of each episode"""
    telemetry: Any
    """float32[N, telemetry_size]"""
    open_actions: Any
    """int64[N], 1 in byte `action` for each action that does not bump"""
    rewards: Any
    """float64[N]"""
    terminated: Any
    """bool[N]"""
    ended: Any
    """int64[N], the episodes that the last step ended, from the start of the array"""
    started: Any
    """int64[N], the episodes that it started, in the same layout"""
    final_grids: Any
    """uint8[N, cells], in the order of `ended`, like all following arrays"""
    final_telemetry: Any
    final_scores: Any
    final_steps: Any
    final_deliveries: Any
    final_seeds: Any


@compiled.inlined
def start_episode(tables: Tables, buffers: Buffers, i: int) -> None:
    """Start episode `i` on map `seeds[i]`."""
    grid, state = buffers.grids[i], buffers.states[i]
    reset_episode(tables, grid, state, buffers.seeds[i])
    write_telemetry(tables, state, buffers.telemetry[i])
    buffers.open_actions[i] = open_actions(tables, grid, state)


@compiled.inlined
def start_next_episode(tables: Tables, buffers: Buffers, i: int) -> None:
    """Start episode `i` on its next map."""
    buffers.seeds[i] = next_seed(buffers.seeds[i])
    start_episode(tables, buffers, i)


@compiled.inlined
def write_final(tables: Tables, buffers: Buffers, i: int, k: int) -> None:
    """Write the result of episode `i` into entry `k`."""
    state = buffers.states[i]
    buffers.final_scores[k] = score(tables, state)
    buffers.final_steps[k] = state[STEPS]
    buffers.final_deliveries[k] = state[DELIVERIES_DONE]
    buffers.final_seeds[k] = buffers.seeds[i]


@compiled.inlined
def write_final_observation(tables: Tables, buffers: Buffers, i: int, k: int) -> None:
    """Write the last observation of episode `i` into entry `k`."""
    for cell in range(tables.cells):
        buffers.final_grids[k, cell] = buffers.grids[i, cell]
    write_telemetry(tables, buffers.states[i], buffers.final_telemetry[k])


@compiled.kernel
def reset_kernel(tables: Tables, buffers: Buffers, chosen: Any) -> None:
    """Start the episodes with the numbers `chosen`, on the maps in `seeds`."""
    for i in chosen:
        start_episode(tables, buffers, i)
        buffers.rewards[i] = 0.0
        buffers.terminated[i] = False


@compiled.kernel
def step_kernel(tables: Tables, rewards: Rewards, buffers: Buffers, actions: Any, n: int, same_step: bool) -> int:
    """Step all n episodes and return how many ended. If an action is not from 0 to 4, change nothing and return -1.

    `n` is unsigned, because compiled code is slower if an index may be negative.
    """
    valid = True
    for i in range(n):
        valid &= (actions[i] >= 0) & (actions[i] < N_ACTIONS)
    if not valid:
        return -1
    n_ended = 0
    n_started = 0
    for i in range(n):
        state = buffers.states[i]
        if state[OUTCOME] != FLYING:
            buffers.started[n_started] = i
            n_started += 1
            buffers.rewards[i] = 0.0
            buffers.terminated[i] = False
            continue
        buffers.rewards[i] = step_episode(tables, rewards, buffers.grids[i], state, actions[i] & ACTION_BITS)
        over = state[OUTCOME] != FLYING
        buffers.terminated[i] = over
        if over:
            buffers.ended[n_ended] = i
            n_ended += 1
        write_own_telemetry(tables, state, buffers.telemetry[i])
        if state[EVENT] == DELIVERED:
            write_target_telemetry(tables, state, buffers.telemetry[i])
        buffers.open_actions[i] = open_actions(tables, buffers.grids[i], state)
    # Rare work has separate loops, because it would take registers from the loop above.
    for k in range(n_ended):
        write_final(tables, buffers, buffers.ended[k], k)
        if same_step:
            write_final_observation(tables, buffers, buffers.ended[k], k)
            buffers.started[n_started] = buffers.ended[k]
            n_started += 1
    for k in range(n_started):
        start_next_episode(tables, buffers, buffers.started[k])
    return n_ended


class Batch:
    """N episodes of one task, stepped together. `copy.deepcopy` and pickle copy the whole state.

    Attributes (the next step overwrites all arrays):
        grids: uint8[N, height, width], cell ids as the drone sees them.
        telemetry: float32[N, telemetry_size], with 5, 6 or 13 values.
        action_masks: int8[N, 5], 0 for each action that would bump. Not enforced.
        rewards: float64[N], rewards of the last step.
        terminated: bool[N], whether the last step ended the episode.
        seeds: int64[N], the map of each episode.

    `ended`, `finals()`, `final_grids` and `final_telemetry` describe the episodes that the last step ended.

    Args:
        task: A task or its name.
        num_envs: N, at least 1.
        reward_profile: A reward profile or its name.
        same_step: If True, a step that ends an episode also starts the next one. If False, the following step starts
            it and ignores its action. The next map is always `seeds.next_seed`.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        num_envs: SupportsIndex,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        same_step: bool = False,
    ) -> None:
        given, num_envs = num_envs, integer(num_envs) or 0
        if num_envs < 1:
            raise InvalidValueError(f"num_envs must be an integer of at least 1, got {given!r}")
        self.task = get_task(task)
        self.num_envs = num_envs
        self.reward_profile = get_reward_profile(reward_profile)
        self.same_step = same_step
        self.tables = tabulate(self.task)
        self._rewards = tabulate_rewards(self.task, self.reward_profile)
        cells, size = self.tables.cells, self.tables.telemetry_size
        finals = num_envs if same_step else 0
        self._buffers = Buffers(
            grids=np.zeros((num_envs, cells), np.uint8),
            states=np.zeros((num_envs, state_size(self.tables)), np.uint16),
            seeds=np.zeros(num_envs, np.int64),
            telemetry=np.zeros((num_envs, size), np.float32),
            open_actions=np.zeros(num_envs, np.dtype("<i8")),
            rewards=np.zeros(num_envs, np.float64),
            terminated=np.zeros(num_envs, np.bool_),
            ended=np.zeros(num_envs, np.int64),
            started=np.zeros(num_envs, np.int64),
            final_grids=np.zeros((finals, cells), np.uint8),
            final_telemetry=np.zeros((finals, size), np.float32),
            final_scores=np.zeros(num_envs, np.float64),
            final_steps=np.zeros(num_envs, np.int64),
            final_deliveries=np.zeros(num_envs, np.int64),
            final_seeds=np.zeros(num_envs, np.int64),
        )
        self.grids = self._buffers.grids.reshape(num_envs, self.task.height, self.task.width)
        self.telemetry = self._buffers.telemetry
        self.action_masks = _unpack(self._buffers.open_actions)
        self.rewards = self._buffers.rewards
        self.terminated = self._buffers.terminated
        self.seeds = self._buffers.seeds
        self._started = np.zeros(num_envs, np.bool_)
        self.started = False
        self._n_ended = np.zeros(1, np.int64)
        self._task = np.array(bytearray(f"{self.task.id} (rules {self.task.digest})", "utf-8"))
        print_before_compiling()
        arguments: Any = (self.tables, self._rewards, self._buffers, self.seeds, np.uint64(num_envs), same_step)
        # Calling the compiled function itself skips Numba's dispatch, about 4 microseconds.
        self._step = step_kernel.compile(tuple(step_kernel.typeof_pyval(argument) for argument in arguments))

    def reset(self, seeds: Sequence[int] | npt.NDArray[np.int64], chosen: npt.NDArray[np.bool_] | None = None) -> None:
        """Start episodes on the maps of these seeds.

        Args:
            seeds: One per episode, in [0, 2^53).
            chosen: bool[N], the episodes to start; None for all. The seeds of the others are ignored.

        Raises:
            InvalidValueError: if the seeds are not N integers in [0, 2^53); nothing changes.
        """
        values = np.asarray(seeds)
        if values.shape != (self.num_envs,) or values.dtype.kind not in "iu":
            raise InvalidValueError(f"seeds must be {self.num_envs} integers, got {values.dtype}{list(values.shape)}")
        numbers = np.arange(self.num_envs) if chosen is None else np.flatnonzero(chosen)
        if len(numbers) and not (values[numbers].min() >= 0 and values[numbers].max() < N_SEEDS):
            raise InvalidValueError("seeds must be integers in [0, 2^53)")
        self.seeds[numbers] = values[numbers]
        reset_kernel(self.tables, self._buffers, numbers)
        self._started[numbers] = True
        self.started = bool(self._started.all())
        self._n_ended[0] = 0

    def step(self, actions: npt.ArrayLike) -> None:
        """Fly one action in each episode and overwrite the buffers.

        Args:
            actions: N integers from 0 to 4.

        Raises:
            InvalidValueError: if the actions are not N integers from 0 to 4; nothing changes.
            EpisodeError: if an episode has not been reset yet; nothing changes.
        """
        values: Any = np.asarray(actions)
        if values.shape != (self.num_envs,) or values.dtype.kind not in "iu":
            raise InvalidValueError(f"actions must be {self.num_envs} integers, got {values.dtype}{list(values.shape)}")
        if not self.started:
            raise EpisodeError("some episodes have not started: call reset() before step()")
        arguments = self.tables, self._rewards, self._buffers, np.ascontiguousarray(values, np.int64), self.num_envs
        n_ended = self._step(*arguments, self.same_step)
        if n_ended < 0:
            wrong = values[(values < 0) | (values >= N_ACTIONS)][0]
            raise InvalidValueError(f"actions must be among {ALLOWED_ACTIONS}; got {wrong}")
        self._n_ended[0] = n_ended

    def get_state(self) -> dict[str, npt.NDArray[Any]]:
        """A snapshot of all episodes for `set_state`, as copies of arrays; `task` is the name of the task in UTF-8."""
        return {name: np.array(buffer) for name, buffer in self._arrays().items()}

    def set_state(self, state: Mapping[str, npt.NDArray[Any]]) -> None:
        """Restore a snapshot of a batch with the same task, size and mode.

        Raises:
            InvalidValueError: if the snapshot does not fit this batch; nothing changes.
        """
        arrays, task = self._arrays(), state.get("task", self._task)
        if not np.array_equal(task, self._task):
            raise InvalidValueError(f"the snapshot is of {bytes(task).decode()}, not of {bytes(self._task).decode()}")
        for name, buffer in arrays.items():
            given = state.get(name)
            if given is None or given.shape != buffer.shape or given.dtype != buffer.dtype:
                raise InvalidValueError(f"the snapshot is of another batch: {name} does not fit")
        for name, buffer in arrays.items():
            buffer[...] = state[name]
        self.started = bool(self._started.all())

    def _arrays(self) -> dict[str, npt.NDArray[Any]]:
        return self._buffers._asdict() | {"has_started": self._started, "n_ended": self._n_ended, "task": self._task}

    def __getstate__(self) -> tuple[tuple[Any, ...], dict[str, npt.NDArray[Any]]]:
        return (self.task, self.num_envs, self.reward_profile, self.same_step), self.get_state()

    def __setstate__(self, state: tuple[tuple[Any, ...], dict[str, npt.NDArray[Any]]]) -> None:
        # Attributes are views of the buffers, so they must not be copied one by one.
        arguments, snapshot = state
        Batch.__init__(self, *arguments)
        self.set_state(snapshot)

    @property
    def ended(self) -> npt.NDArray[np.int64]:
        """int64[k], the numbers of the episodes that the last step ended."""
        return self._of_ended(self._buffers.ended)

    def finals(self) -> dict[str, npt.NDArray[Any]]:
        """Results of the episodes in `ended`: `score` (float64[k]), `steps`, `deliveries` and `seed` (int64[k])."""
        return {
            "score": self._of_ended(self._buffers.final_scores),
            "steps": self._of_ended(self._buffers.final_steps),
            "deliveries": self._of_ended(self._buffers.final_deliveries),
            "seed": self._of_ended(self._buffers.final_seeds),
        }

    @property
    def final_grids(self) -> npt.NDArray[np.uint8]:
        """uint8[k, height, width], the last grids of the episodes in `ended`."""
        if not self.same_step:
            return self.grids[self.ended]
        return np.reshape(self._of_ended(self._buffers.final_grids), (-1, self.task.height, self.task.width))

    @property
    def final_telemetry(self) -> npt.NDArray[np.float32]:
        """float32[k, telemetry_size], the last telemetry of the episodes in `ended`."""
        return self._of_ended(self._buffers.final_telemetry) if self.same_step else self.telemetry[self.ended]

    def copy_action_masks(self) -> npt.NDArray[np.int8]:
        """A copy of the action masks, int8[N, 5]; faster than `action_masks.copy()`."""
        return _unpack(self._buffers.open_actions.copy())

    def _of_ended(self, buffer: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The entries that the last step wrote."""
        return buffer[: self._n_ended[0]]


def _unpack(packed: npt.NDArray[np.int64]) -> npt.NDArray[np.int8]:
    """A view, int8[N, 5], of integers with one action per byte."""
    array: Any = packed
    return array.view(np.int8).reshape(len(packed), 8)[:, :N_ACTIONS]
