"""A tour network that learns from rewards alone: no exact value is ever asked for.

From each state K whole plans are drawn from the network and flown in the simulator, which pays a plan its score at the
end. Where they differ, the best of them is imitated, as in self-labelling (Corsini et al., "Self-labeling the job shop
scheduling problem", NeurIPS 2024). Whether the mission was completed after a choice, which every plan tells, teaches
the second output. What flies is the average of the weights, as of a distilled network.
"""

import math
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from drone_env.agents.tour_plans import TourPlanner
from drone_env.agents.tour_view import View
from drone_env.agents.tour_viewer import Viewer
from drone_env.agents.tournet import Network
from drone_env.core.compile_cache import compiled_once
from drone_env.core.rewards import tabulate_rewards
from drone_env.core.rules import reset
from drone_env.core.seeds import GOLDEN, SPLITS, mix64
from drone_env.core.tables import BATTERY, CELL, DELIVERIES_DONE, PARCELS, STEPS, UNDER, state_size, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import counts_units
from drone_env.planning.states import UNPAID
from drone_env.rl.lessons import Lessons, World, take_off
from drone_env.rl.tour_batch import Batch, chosen_by
from drone_env.rl.tour_config import TourConfig
from drone_env.rl.tour_trainer import TourProgress, TourTrainer

TEMPERATURES = 1.0, 1.0
COMPLETED, IMITATED = 1.0, 2.0
"""The value of an option that was flown is the sum of what holds; that of one that was not is NaN."""


@compiled_once(nogil=True)
def take_off_kernel(world: World, counts: int, seeds: Any, grids: Any, states: Any) -> None:
    """Begin a flight on each map, uint8[N, cells] and uint16[N, state size], as lessons do."""
    tables, _, grid, state, _ = world
    for k in range(len(seeds)):
        reset(tables, grid, state, seeds[k])
        start, key, flies = state[CELL] * 1, mix64(seeds[k] ^ GOLDEN), False
        grid[start] = state[UNDER]
        while not flies:
            key, flies = take_off(world, counts, start, key)
        grids[k] = grid
        states[k] = state


class Tried(NamedTuple):
    """Choices that were flown, n of them."""

    grounds: npt.NDArray[np.uint8]
    """uint8[n, cells], without the drone."""
    drones: npt.NDArray[np.int64]
    """int64[n, 3]: cell, units left, steps left."""
    chosen: npt.NDArray[np.int64]
    """int64[n], which of the options was taken, counted from the first."""
    values: npt.NDArray[np.float32]
    """float32[n], what the option is worth: see `COMPLETED`."""


class Explorer:
    """Flies plans on one task and keeps what came of their choices.

    Args:
        task: The task.
        network: Draws the plans.
        plans: K, how many of each state.
    """

    def __init__(self, task: TaskConfig, network: Network, plans: int) -> None:
        tables = tabulate(task)
        self._task, self._plans = task, plans
        self._planner = TourPlanner(task, network, plans, TEMPERATURES)
        self._viewer = Viewer(task)
        grid, state = np.zeros(tables.cells, np.uint8), np.zeros(state_size(tables), np.uint16)
        parcels = PARCELS + np.arange(task.deliveries)
        self._world = World(tables, tabulate_rewards(task, UNPAID), grid, state, parcels)

    def begin(self, seeds: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]:
        """A flight on each map, at its start or anywhere: uint8[N, cells] grids, uint16[N, state size] states."""
        grids = np.zeros((len(seeds), len(self._world.grid)), np.uint8)
        states = np.zeros((len(seeds), len(self._world.state)), np.uint16)
        take_off_kernel(self._world, int(counts_units(self._task)), seeds, grids, states)
        return grids, states

    def fly(self, seeds: npt.NDArray[np.int64], random: np.random.Generator) -> Tried:
        """Fly K plans from a state of each map: the choices of the best, and as many others'."""
        seen: list[tuple[npt.NDArray[Any], ...]] = []

        def watch(
            flying: npt.NDArray[np.int64],
            grids: npt.NDArray[np.uint8],
            states: npt.NDArray[np.uint16],
            chosen: npt.NDArray[np.int64],
        ) -> None:
            seen.append((flying, grids, states, chosen))

        flights = self._planner.fly(*self.begin(seeds), seeds, watch)
        flying, grids, states, chosen = map(np.concatenate, zip(*seen, strict=True))
        scores = flights.scores.reshape(-1, self._plans)
        best = np.arange(len(seeds)) * self._plans + scores.argmax(axis=1)
        imitated = np.zeros(scores.size, np.bool_)
        imitated[best] = scores.max(axis=1) > scores.min(axis=1)
        completed = flights.states[:, DELIVERIES_DONE] == self._task.deliveries
        of_best = np.flatnonzero(imitated[flying] & (chosen >= 0))
        others = np.flatnonzero(~imitated[flying] & (chosen >= 0))
        kept = np.concatenate([of_best, random.permutation(others)[: max(len(of_best), len(seeds))]])
        numbers = states[kept].astype(np.int64)
        grounds = grids[kept]
        grounds[np.arange(len(kept)), numbers[:, CELL]] = numbers[:, UNDER]
        left = self._task.max_steps - numbers[:, STEPS]
        values = COMPLETED * completed[flying[kept]] + IMITATED * imitated[flying[kept]]
        return Tried(
            grounds,
            np.stack([numbers[:, CELL], numbers[:, BATTERY], left], axis=1),
            chosen[kept],
            values.astype(np.float32),
        )

    def lessons(self, tried: Tried) -> Lessons:
        """What the choices teach."""
        parts: list[View] = []
        for i in range(0, max(len(tried.chosen), 1), self._viewer.most):
            some = slice(i, i + self._viewer.most)
            view = self._viewer.views(tried.grounds[some], tried.drones[some])
            parts.append(View(*(array.copy() for array in view)))
        tokens, present, edges, _, token, features, numbers = (
            np.concatenate([part[k] for part in parts]) for k in range(len(View._fields))
        )
        counts = np.concatenate([np.diff(part.begins) for part in parts])
        begins = np.concatenate([[0], counts.cumsum()])
        values = np.full(len(token), np.nan, np.float32)
        values[begins[:-1] + tried.chosen] = tried.values
        return Lessons(View(tokens, present, edges, begins, token, features, numbers), values)


class RewardTrainer(TourTrainer):
    """One training of a tour network from rewards alone. Arguments and errors are those of `TourTrainer`."""

    kind = "rewards"

    def __init__(self, config: TourConfig) -> None:
        super().__init__(config)
        self._tried: list[deque[Tried]] = [deque(maxlen=config.window) for _ in self._windows]

    def _prepare(self, tasks: list[TaskConfig]) -> None:
        self._explorers = [Explorer(task, self._explores, self.config.plans) for task in tasks]

    def train(self) -> Iterator[list[TourProgress]]:
        """Fly and learn until `config.updates` updates are made; yields after each, as `TourTrainer.train` does."""
        while self.updates < self.config.updates:
            chunk, train = self.updates, SPLITS["train"]
            subject = self._subject(chunk)
            seeds = self._random(chunk, 1).integers(train.start, train.stop, self.config.maps_per_chunk)
            tried = self._explorers[subject].fly(seeds, self._random(chunk, 3))
            self._tried[subject].append(tried)
            self._windows[subject].append(self._explorers[subject].lessons(tried))
            self._learn()
            yield self._log()

    def _explores(self, view: View) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        return self._says(self.online, view)

    def _losses_of(self, preference: Tensor, completion: Tensor, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        return losses_of_tries(preference, completion, batch)

    def get_state(self) -> dict[str, Any]:
        """As `TourTrainer.get_state`, with what was tried last."""
        tried = [[[torch.from_numpy(array) for array in one] for one in window] for window in self._tried]
        return super().get_state() | {"tried": tried}

    def set_state(self, state: dict[str, Any]) -> None:
        """As `TourTrainer.set_state`."""
        super().set_state(state)
        for window, tried, explorer, kept in zip(
            self._windows, self._tried, self._explorers, state["tried"], strict=True
        ):
            tried.extend(Tried(*(tensor.numpy() for tensor in one)) for one in kept)
            window.extend(map(explorer.lessons, tried))


def losses_of_tries(preference: Tensor, completion: Tensor, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
    """Cross-entropy of the imitated choices, NaN, since regrets are not known, and that of the completions.

    Args:
        preference: float32[options], what the network says of each option.
        completion: float32[options], the logit of whether the mission can be completed after it.
        batch: What it was asked; the values of its options are those of `Explorer.lessons`.
    """
    log_chosen = batch.of_options(batch.table(chosen_by(preference, completion), -math.inf).log_softmax(1))
    tried = ~batch.values.isnan()
    imitated = batch.values >= IMITATED
    choice = -(log_chosen[imitated].sum() / imitated.sum().clamp(min=1))
    completed = (batch.values[tried] % IMITATED) == COMPLETED
    return choice, torch.tensor(math.nan), binary_cross_entropy_with_logits(completion[tried], completed.float())
