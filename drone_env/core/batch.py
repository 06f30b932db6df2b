"""N episodes of one task at once: the functions of `rules`, compiled, in one loop over the episodes.

Every buffer of a `Batch` is overwritten by the next step: copy what you keep.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, SupportsIndex

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import ALLOWED_ACTIONS, FLYING, N_ACTIONS, Event, integer
from drone_env.core.compile_cache import compiled_once, tell_before_compiling
from drone_env.core.observation import open_actions, write_own_telemetry, write_target_telemetry, write_telemetry
from drone_env.core.rewards import DEFAULT_PROFILE, RewardProfile, Rewards, get_reward_profile, tabulate_rewards
from drone_env.core.rules import reset as reset_episode
from drone_env.core.rules import score
from drone_env.core.rules import step as step_episode
from drone_env.core.seeds import N_SEEDS, next_seed
from drone_env.core.tables import CELL, DELIVERIES_DONE, EVENT, OUTCOME, STEPS, Tables, state_size, tabulate
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError

DELIVERED = int(Event.DELIVERY)
prefetch = compiled.prefetch
ACTION_BITS = 7
"""Changes no action from 0 to 4; with it the compiler assumes that none is negative."""
OWN_CACHE = 3 << 19
"""Bytes of grids from which on a core's own cache no longer holds them between two steps (of 2 MiB, by measurement)."""
AHEAD, ONE = np.uint64(16), np.uint64(1)
"""How many episodes ahead a step fetches their grids then."""


class Buffers(NamedTuple):
    """The arrays of a batch of N episodes, as the kernels see them."""

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
    """int64[N], the episodes that the last step ended, from the start of each thread's range on"""
    begun: Any
    """int64[N], likewise those that it began"""
    final_grids: Any
    """uint8[N, cells], in the order of `ended`, as are the following"""
    final_telemetry: Any
    final_scores: Any
    final_steps: Any
    final_deliveries: Any
    final_seeds: Any


def begin(tables: Tables, buffers: Buffers, i: int) -> None:
    """Begin episode `i` on the map of its entry in `seeds`."""
    grid, state = buffers.grids[i], buffers.states[i]
    reset_episode(tables, grid, state, buffers.seeds[i])
    write_telemetry(tables, state, buffers.telemetry[i])
    buffers.open_actions[i] = open_actions(tables, grid, state)


def begin_next(tables: Tables, buffers: Buffers, i: int) -> None:
    """Begin episode `i` on the map that follows its last one."""
    buffers.seeds[i] = next_seed(buffers.seeds[i])
    begin(tables, buffers, i)


def keep_final(tables: Tables, buffers: Buffers, i: int, k: int) -> None:
    """Write how episode `i` ended into entry `k`."""
    state = buffers.states[i]
    buffers.final_scores[k] = score(tables, state)
    buffers.final_steps[k] = state[STEPS]
    buffers.final_deliveries[k] = state[DELIVERIES_DONE]
    buffers.final_seeds[k] = buffers.seeds[i]


def keep_final_observation(tables: Tables, buffers: Buffers, i: int, k: int) -> None:
    """Write the last observation of episode `i` into entry `k`."""
    for cell in range(tables.cells):
        buffers.final_grids[k, cell] = buffers.grids[i, cell]
    write_telemetry(tables, buffers.states[i], buffers.final_telemetry[k])


@compiled.kernel
def reset_kernel(tables: Tables, buffers: Buffers, chosen: Any) -> None:
    """Begin the episodes whose numbers are in `chosen`, on the maps in `seeds`."""
    for i in chosen:
        begin(tables, buffers, i)
        buffers.rewards[i] = 0.0
        buffers.terminated[i] = False


@compiled.kernel
def step_kernel(
    tables: Tables, rewards: Rewards, buffers: Buffers, actions: Any, start: int, stop: int, same_step: bool
) -> int:
    """Step the episodes from `start` to `stop` and return how many ended.

    The two are unsigned numbers: compiled code then needs no care for indices below zero.
    """
    n_ended = 0
    n_begun = 0
    prefetching = (stop - start) * tables.cells > OWN_CACHE
    for i in range(start, stop):
        if prefetching:
            ahead = min(i + AHEAD, stop - ONE)
            prefetch(buffers.grids, ahead, buffers.states[ahead, CELL])
        state = buffers.states[i]
        if state[OUTCOME] != FLYING:
            buffers.begun[start + n_begun] = i
            n_begun += 1
            buffers.rewards[i] = 0.0
            buffers.terminated[i] = False
            continue
        buffers.rewards[i] = step_episode(tables, rewards, buffers.grids[i], state, actions[i] & ACTION_BITS)
        over = state[OUTCOME] != FLYING
        buffers.terminated[i] = over
        if over:
            buffers.ended[start + n_ended] = i
            n_ended += 1
        write_own_telemetry(tables, state, buffers.telemetry[i])
        if state[EVENT] == DELIVERED:
            write_target_telemetry(tables, state, buffers.telemetry[i])
        buffers.open_actions[i] = open_actions(tables, buffers.grids[i], state)
    # Rare work has separate loops: between the steps it would cost them registers.
    for k in range(start, start + n_ended):
        keep_final(tables, buffers, buffers.ended[k], k)
        if same_step:
            keep_final_observation(tables, buffers, buffers.ended[k], k)
            buffers.begun[start + n_begun] = buffers.ended[k]
            n_begun += 1
    for k in range(start, start + n_begun):
        begin_next(tables, buffers, buffers.begun[k])
    return n_ended


@compiled_once(nogil=True, parallel=True)
def step_kernel_threads(
    tables: Tables, rewards: Rewards, buffers: Buffers, actions: Any, bounds: Any, same_step: bool, n_ended: Any
) -> None:
    """Step the ranges between neighbouring `bounds`, one thread each."""
    for t in numba.prange(len(bounds) - 1):
        n_ended[t] = step_kernel(tables, rewards, buffers, actions, bounds[t], bounds[t + 1], same_step)


@compiled.kernel
def all_exist(actions: Any) -> bool:
    """Whether all of the actions, int64[N], are from 0 to 4."""
    allowed = True
    for i in range(len(actions)):
        allowed &= (actions[i] >= 0) & (actions[i] < N_ACTIONS)
    return allowed


for part in (begin, begin_next, keep_final, keep_final_observation):
    register_jitable(forceinline=True, **compiled.OPTIONS)(part)


def entry_point(kernel: Any, *arguments: Any) -> Any:
    """The compiled function for arguments of these types: calling it skips the dispatch, some 4 microseconds."""
    return kernel.compile(tuple(kernel.typeof_pyval(argument) for argument in arguments))


class Batch:
    """N episodes of one task, stepped together. A copy, by `copy.deepcopy` or by pickle, flies on as the original does.

    Attributes, all arrays over the episodes and overwritten by the next step:
        grids: uint8[N, height, width], cell ids as the drone sees them.
        telemetry: float32[N, telemetry_size]: 5, 6 or 13 values, by the task.
        action_masks: int8[N, 5], 0 for each action that would bump. Advice, never enforced.
        rewards: float64[N], of the last step.
        terminated: bool[N], whether the last step ended the episode.
        seeds: int64[N], the map that each episode flies.

    About the episodes that the last step ended: `ended`, `finals()`, `final_grids`, `final_telemetry`.

    Args:
        task: A task or its name.
        num_envs: N, at least 1.
        reward_profile: A reward profile or its name.
        same_step: Whether a step that ends an episode begins the next one at once; otherwise the following step does,
            whatever its action. Either way it flies the map that `seeds.next_seed` names.
        num_threads: How many threads share a step.

    Raises:
        UnknownNameError: if there is no such task or profile.
        InvalidValueError: if a number is not an integer or below 1.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        num_envs: SupportsIndex,
        reward_profile: str | RewardProfile = DEFAULT_PROFILE,
        same_step: bool = False,
        num_threads: SupportsIndex = 1,
    ) -> None:
        num_envs, num_threads = _count("num_envs", num_envs), _count("num_threads", num_threads)
        self.task = get_task(task)
        self.num_envs = num_envs
        self.num_threads = num_threads
        self.reward_profile = get_reward_profile(reward_profile)
        self.same_step = same_step
        self.tables = tabulate(self.task)
        self._rewards = tabulate_rewards(self.task, self.reward_profile)
        cells, size = self.tables.cells, self.task.telemetry_size
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
            begun=np.zeros(num_envs, np.int64),
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
        self._bounds = np.linspace(0, num_envs, min(num_threads, num_envs) + 1).astype(np.uint64)
        self._all = (0, num_envs)  # plain numbers, which a call takes faster than those of an array
        self._n_ended = np.zeros(len(self._bounds) - 1, np.int64)
        self._compile()

    def _compile(self) -> None:
        tell_before_compiling()
        tables = (self.tables, self._rewards, self._buffers, self.seeds)
        self._all_exist = entry_point(all_exist, self.seeds)
        if len(self._bounds) == 2:
            self._step = entry_point(step_kernel, *tables, *self._bounds, self.same_step)
        else:
            self._step = entry_point(step_kernel_threads, *tables, self._bounds, self.same_step, self._n_ended)

    def reset(self, seeds: Sequence[int] | npt.NDArray[np.int64], chosen: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin episodes on the maps of these seeds.

        Args:
            seeds: One for each episode, in [0, 2^53).
            chosen: bool[N], which episodes to begin; None for all. The seeds of the others are not used.

        Raises:
            InvalidValueError: if the seeds are not N integers in [0, 2^53); nothing is changed.
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
        self._n_ended[:] = 0

    def step(self, actions: npt.ArrayLike) -> None:
        """Fly one action in each episode and overwrite the buffers.

        Args:
            actions: N integers from 0 to 4. In an episode that is to begin again its action is not used.

        Raises:
            InvalidValueError: if they are not; nothing is flown.
            EpisodeError: if some episode has not been reset yet; nothing is flown.
        """
        values: Any = np.asarray(actions)
        if values.shape != (self.num_envs,) or values.dtype.kind not in "iu":
            raise InvalidValueError(f"actions must be {self.num_envs} integers, got {values.dtype}{list(values.shape)}")
        if not self.started:
            raise EpisodeError("some episodes have not begun: call reset() before step()")
        integers = np.ascontiguousarray(values, np.int64)
        if not self._all_exist(integers):
            wrong = values[(values < 0) | (values >= N_ACTIONS)][0]
            raise InvalidValueError(f"actions must be among {ALLOWED_ACTIONS}; got {wrong}")
        tables = (self.tables, self._rewards, self._buffers, integers)
        if len(self._bounds) == 2:
            self._n_ended[0] = self._step(*tables, *self._all, self.same_step)
        else:
            self._step(*tables, self._bounds, self.same_step, self._n_ended)

    def get_state(self) -> dict[str, npt.NDArray[Any]]:
        """A snapshot of all episodes, as copies of arrays; `set_state` returns to it."""
        return {name: np.array(buffer) for name, buffer in self._kept().items()}

    def set_state(self, state: Mapping[str, npt.NDArray[Any]]) -> None:
        """Return to a snapshot of a batch of the same task, size, mode and threads.

        Raises:
            InvalidValueError: if the snapshot is of another batch; nothing is changed.
        """
        own = self._kept()
        for name, buffer in own.items():
            given = state.get(name)
            if given is None or given.shape != buffer.shape or given.dtype != buffer.dtype:
                raise InvalidValueError(f"the snapshot is of another batch: {name} does not fit")
        for name, buffer in own.items():
            buffer[...] = state[name]
        self.started = bool(self._started.all())

    def _kept(self) -> dict[str, npt.NDArray[Any]]:
        return self._buffers._asdict() | {"started": self._started, "n_ended": self._n_ended}

    def __getstate__(self) -> tuple[tuple[Any, ...], dict[str, npt.NDArray[Any]]]:
        arguments = (self.task, self.num_envs, self.reward_profile, self.same_step, self.num_threads)
        return arguments, self.get_state()

    def __setstate__(self, state: tuple[tuple[Any, ...], dict[str, npt.NDArray[Any]]]) -> None:
        # Attributes are views of the buffers: copied one by one they would be none any more.
        arguments, snapshot = state
        Batch.__init__(self, *arguments)
        self.set_state(snapshot)

    @property
    def ended(self) -> npt.NDArray[np.int64]:
        """int64[k], the numbers of the episodes that the last step ended."""
        return self._of_ended(self._buffers.ended)

    def finals(self) -> dict[str, npt.NDArray[Any]]:
        """How the episodes ended that the last step ended, in the order of `ended`: views, as all buffers.

        `score` (graded, float64[k]), `steps`, `deliveries` and `seed` (int64[k]).
        """
        buffers = self._buffers
        return {
            "score": self._of_ended(buffers.final_scores),
            "steps": self._of_ended(buffers.final_steps),
            "deliveries": self._of_ended(buffers.final_deliveries),
            "seed": self._of_ended(buffers.final_seeds),
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
        """The action masks as they are now, int8[N, 5]: faster than copying the array."""
        return _unpack(self._buffers.open_actions.copy())

    def _of_ended(self, buffer: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The entries that the threads have written, each from the start of its range on."""
        counts = self._n_ended.tolist()
        if len(counts) == 1:
            return buffer[: counts[0]]
        starts = self._bounds[:-1].tolist()
        return np.concatenate([buffer[start : start + n] for start, n in zip(starts, counts, strict=True)])


def _count(name: str, value: SupportsIndex) -> int:
    number = integer(value)
    if number is None or number < 1:
        raise InvalidValueError(f"{name} must be an integer of at least 1, got {value!r}")
    return number


def _unpack(packed: npt.NDArray[np.int64]) -> npt.NDArray[np.int8]:
    """int8[N, 5] from integers that hold one action a byte; a view."""
    octets: Any = packed
    return octets.view(np.int8).reshape(len(packed), 8)[:, :N_ACTIONS]
