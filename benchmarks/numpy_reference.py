"""The tables of the standard tasks once more, as whole-array NumPy code: what `simulator.py` compares the batch with.

A reference for the benchmark alone, for tasks without mechanics and the `tiered` rewards. A step that follows the end
of an episode begins the next one, as `Batch` does it. The maps come out of a pool that is made before the clock
runs, so a reset here copies a map and does not draw one: it is cheaper than a reset of `Batch`.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env import TaskConfig, generate_city_map, next_seed
from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.batch import Batch
from drone_env.core.cells import Cell
from drone_env.core.rewards import get_reward_profile, tabulate_rewards
from drone_env.core.rules import HIGHEST, LOWEST
from drone_env.core.tables import NOWHERE, tabulate

FAR_AWAY = 1 << 30


class Pool(NamedTuple):
    """Maps in the order in which one episode after the other flies them."""

    seeds: npt.NDArray[np.int64]
    grids: npt.NDArray[np.uint8]
    """uint8[maps, cells], the drone on its start."""
    starts: npt.NDArray[np.int64]
    parcels: npt.NDArray[np.int64]
    """int64[maps, deliveries], the cell of each parcel."""


def make_pool(task: TaskConfig, maps: int) -> Pool:
    """A walk of `maps` maps, each the one that follows its neighbour."""
    seeds = [0]
    while len(seeds) < maps:
        seeds.append(next_seed(seeds[-1]))
    drawn = [generate_city_map(task, seed) for seed in seeds]
    starts = np.array([m.start[1] * task.width + m.start[0] for m in drawn])
    grids = np.array([m.grid.ravel() for m in drawn])
    grids[np.arange(maps), starts] = Cell.DRONE
    parcels = np.array([[y * task.width + x for x, y in m.deliveries] for m in drawn])
    return Pool(np.array(seeds), grids, starts, parcels)


class NumpyBatch:
    """N episodes of a standard task, stepped by NumPy over all of them at once.

    Attributes:
        grids: uint8[N, height, width].
        telemetry: float32[N, 5].
        action_masks: int8[N, 5], 0 for each action that would bump.
        rewards: float64[N].
        terminated: bool[N].
        ended: int64[k], the numbers of the episodes that the last step ended.
        final_scores: float64[k], their graded scores.

    Args:
        task: A task on which every step costs one battery unit and leads anywhere.
        num_envs: N.
        pool: The maps to fly.
    """

    def __init__(self, task: TaskConfig, num_envs: int, pool: Pool) -> None:
        if not task.uniform or task.battery_capacity != task.max_steps:
            raise ValueError("the reference knows the standard tasks alone")
        tables = tabulate(task)
        self.num_envs = num_envs
        self._pool = pool
        self._maps = np.zeros(num_envs, np.int64)
        self._deliveries, self._max_steps = task.deliveries, task.max_steps

        moves = np.array(tables.moves).astype(np.int64).reshape(-1, N_ACTIONS)
        self._bump = (moves == NOWHERE).ravel()
        stay = np.arange(tables.cells)[:, None]
        self._moves = np.where(moves == NOWHERE, stay, moves).ravel()
        self._events = np.array(tables.flight_event).astype(np.int64)
        self._x, self._y = (np.array(table).astype(np.int64) for table in (tables.columns, tables.rows))
        self._x_share, self._y_share = np.array(tables.shares).reshape(-1, 2).T.copy()
        self._units_share = np.array(tables.steps_share)
        masks = np.zeros((tables.cells, 8), np.int8)  # eight bytes: looked up as one number
        masks[:, :N_ACTIONS] = moves != NOWHERE
        self._masks = masks.view(np.int64)[:, 0].copy()
        self._pays = np.array(tabulate_rewards(task, get_reward_profile("tiered")).events)

        self.grids = np.zeros((num_envs, task.height, task.width), np.uint8)
        self._grid = self.grids.reshape(-1)
        self._offsets = np.arange(num_envs) * tables.cells
        self._cell = np.zeros(num_envs, np.int64)
        self._under = np.zeros(num_envs, np.uint8)
        self._steps = np.zeros(num_envs, np.int64)
        self._delivered = np.zeros(num_envs, np.int64)
        self._target = np.zeros(num_envs, np.int64)
        self._distance = np.zeros(num_envs, np.int64)
        self._parcels = np.zeros((num_envs, task.deliveries), np.int64)
        self._waiting = np.zeros((num_envs, task.deliveries), np.bool_)
        self.telemetry = np.zeros((num_envs, 5), np.float32)
        self._open = np.zeros(num_envs, np.int64)
        self.action_masks = self._open.view(np.int8).reshape(num_envs, 8)[:, :N_ACTIONS]
        self.rewards = np.zeros(num_envs)
        self.terminated = np.zeros(num_envs, np.bool_)
        self.ended = np.zeros(0, np.int64)
        self.final_scores = np.zeros(0)

    def reset(self, maps: npt.NDArray[np.int64], chosen: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin the chosen episodes (None: all) on maps of the pool: N numbers of maps."""
        numbers = np.arange(self.num_envs) if chosen is None else np.flatnonzero(chosen)
        self._begin(numbers, maps[numbers])

    def step(self, actions: npt.NDArray[np.int64]) -> None:
        """Take one action in each episode, and reset the episodes that have ended."""
        anew = np.flatnonzero(self.terminated)
        looked_up = self._cell * N_ACTIONS
        looked_up += actions
        bump = self._bump[looked_up]
        cell = self._moves[looked_up]
        self._grid[self._offsets + self._cell] = self._under
        at = self._offsets + cell
        under = self._grid[at]
        self._grid[at] = Cell.DRONE
        self._cell = cell
        self._steps += 1

        before = self._distance
        self._distance = np.abs(self._x[cell] - self._x[self._target])
        self._distance += np.abs(self._y[cell] - self._y[self._target])
        closer = before - self._distance
        out = self._steps >= self._max_steps
        event = self._events[under.astype(np.int64) * N_ACTIONS + actions]
        event[bump] = Event.WALL
        event[out] = Event.BATTERY_DEAD
        over = out
        delivering = np.flatnonzero(under == Cell.DELIVERY)
        if len(delivering):
            event[delivering] = Event.DELIVERY
            under[delivering] = Cell.DELIVERED
            self._deliver(delivering)
            over = out | (self._delivered == self._deliveries)
        self._under = under
        event *= 3
        event += closer
        event += 1
        np.take(self._pays, event, out=self.rewards, mode="clip")
        np.copyto(self.terminated, over)

        if len(anew):
            self._begin(anew, (self._maps[anew] + 1) % len(self._pool.seeds))
        self.ended = np.flatnonzero(self.terminated)
        if len(self.ended):
            self.final_scores = self._scores(self.ended)
        self.telemetry[:, 0] = self._x_share[self._cell]
        self.telemetry[:, 1] = self._y_share[self._cell]
        self.telemetry[:, 2] = self._units_share[self._steps]
        if len(delivering):
            self._see_targets(delivering)
        np.take(self._masks, self._cell, out=self._open, mode="clip")

    def _begin(self, numbers: npt.NDArray[np.int64], maps: npt.NDArray[np.int64]) -> None:
        self._maps[numbers] = maps
        self.grids.reshape(self.num_envs, -1)[numbers] = self._pool.grids[maps]
        self._cell[numbers] = self._pool.starts[maps]
        self._under[numbers] = Cell.ROAD
        self._steps[numbers] = 0
        self._delivered[numbers] = 0
        self._parcels[numbers] = self._pool.parcels[maps]
        self._waiting[numbers] = True
        self._choose_targets(numbers)
        self.rewards[numbers] = 0.0
        self.terminated[numbers] = False
        cell = self._cell[numbers]
        self.telemetry[numbers, 0] = self._x_share[cell]
        self.telemetry[numbers, 1] = self._y_share[cell]
        self.telemetry[numbers, 2] = 1.0
        self._see_targets(numbers)
        self._open[numbers] = self._masks[cell]

    def _deliver(self, numbers: npt.NDArray[np.int64]) -> None:
        self._delivered[numbers] += 1
        here = self._parcels[numbers] == self._cell[numbers, None]
        self._waiting[numbers] &= ~here
        self._choose_targets(numbers[self._distance[numbers] == 0])

    def _choose_targets(self, numbers: npt.NDArray[np.int64]) -> None:
        """The nearest waiting parcel, the first of equally near ones; the drone's own cell where none waits."""
        parcels, cell = self._parcels[numbers], self._cell[numbers, None]
        far = np.abs(self._x[parcels] - self._x[cell]) + np.abs(self._y[parcels] - self._y[cell])
        far[~self._waiting[numbers]] = FAR_AWAY
        nearest = far.argmin(axis=1)
        each = np.arange(len(numbers))
        far = far[each, nearest]
        none_waits = far == FAR_AWAY
        self._target[numbers] = np.where(none_waits, cell[:, 0], parcels[each, nearest])
        self._distance[numbers] = np.where(none_waits, 0, far)

    def _see_targets(self, numbers: npt.NDArray[np.int64]) -> None:
        target = self._target[numbers]
        self.telemetry[numbers, 3] = self._x_share[target]
        self.telemetry[numbers, 4] = self._y_share[target]

    def _scores(self, numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        total, steps, capacity = self._deliveries, self._max_steps, self._max_steps
        left = self._max_steps - self._steps[numbers]
        tenths = 8 * self._delivered[numbers] * capacity * steps + total * (left * steps + left * capacity)
        return np.clip(tenths / (10 * total * capacity * steps), LOWEST, HIGHEST)


def check(task: TaskConfig, pool: Pool, steps: int = 400, num_envs: int = 64) -> None:
    """Fly the reference and `Batch` side by side, mostly towards the targets, and compare all that they show.

    Raises:
        AssertionError: if they differ anywhere.
    """
    maps = np.arange(num_envs) * (len(pool.seeds) // (2 * num_envs))
    reference, batch = NumpyBatch(task, num_envs, pool), Batch(task, num_envs, "tiered")
    reference.reset(maps)
    batch.reset(pool.seeds[maps])
    random = np.random.default_rng(0)
    for _ in range(steps):
        dx, dy = (batch.telemetry[:, 3:] - batch.telemetry[:, :2]).T
        nearer = np.where(dx != 0, np.where(dx > 0, 3, 2), np.where(dy > 0, 1, 0))
        actions = np.where(random.random(num_envs) < 0.6, nearer, random.integers(0, N_ACTIONS, num_envs))
        reference.step(actions)
        batch.step(actions)
        for name in ("grids", "telemetry", "action_masks", "rewards", "terminated", "ended"):
            np.testing.assert_array_equal(getattr(reference, name), getattr(batch, name), err_msg=name)
        if len(batch.ended):
            np.testing.assert_array_equal(reference.final_scores, batch.finals()["score"])
