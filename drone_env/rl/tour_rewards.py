"""Training of the tour network from rewards alone, without exact values.

From each state the network samples K whole plans; the simulator flies them and pays each its score at the end. Where
the scores differ, the best plan is imitated, as in self-labelling (Corsini et al., "Self-labeling the job shop
scheduling problem", NeurIPS 2024). Every plan shows whether the mission was completed after a choice, which trains the
second output. The exported network is the moving average of the weights.
"""

import math
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from drone_env.agents.tour_encoder import FeatureEncoder
from drone_env.agents.tour_features import Features
from drone_env.agents.tour_plans import TourPlanner
from drone_env.agents.tournet import Network
from drone_env.core.compile_cache import compiled_once
from drone_env.core.rewards import tabulate_rewards
from drone_env.core.rules import reset
from drone_env.core.seeds import GOLDEN, mix64
from drone_env.core.tables import BATTERY, CELL, DELIVERIES_DONE, PARCELS, STEPS, UNDER, state_size, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import counts_units
from drone_env.planning.states import UNPAID
from drone_env.rl.samples import Samples, Workspace, sample_start_state
from drone_env.rl.tour_config import TourConfig
from drone_env.rl.tournet import TourBatch, TourProgress, TourTrainer, choice_logits

TEMPERATURES = 1.0, 1.0
COMPLETED, IMITATED = 1.0, 2.0
"""The value of a flown option is the sum of what applies; that of another option is NaN."""


@compiled_once(nogil=True)
def start_kernel(workspace: Workspace, counts: int, seeds: Any, grids: Any, states: Any) -> None:
    """Write the start of a flight on each map to uint8[N, cells] and uint16[N, state size]."""
    tables, _, grid, state, _ = workspace
    for k in range(len(seeds)):
        reset(tables, grid, state, seeds[k])
        start, key, free = state[CELL] * 1, mix64(seeds[k] ^ GOLDEN), False
        grid[start] = state[UNDER]
        while not free:
            key, free = sample_start_state(workspace, counts, start, key)
        grids[k] = grid
        states[k] = state


class Trials(NamedTuple):
    """Choices of flown plans, n of them."""

    grounds: npt.NDArray[np.uint8]
    """uint8[n, cells], without the drone."""
    drones: npt.NDArray[np.int64]
    """int64[n, 3]: cell, units left, steps left."""
    chosen: npt.NDArray[np.int64]
    """int64[n], the number of the flown option."""
    values: npt.NDArray[np.float32]
    """float32[n], its value: see `COMPLETED`."""


class Explorer:
    """Flies plans on one task and collects their choices.

    Args:
        task: The task.
        network: Samples the plans.
        plans: K, the number of plans from each state.
    """

    def __init__(self, task: TaskConfig, network: Network, plans: int) -> None:
        tables = tabulate(task)
        self._task, self._plans = task, plans
        self._planner = TourPlanner(task, network, plans, TEMPERATURES)
        self._encoder = FeatureEncoder(task)
        grid, state = np.zeros(tables.cells, np.uint8), np.zeros(state_size(tables), np.uint16)
        parcels = PARCELS + np.arange(task.deliveries)
        self._workspace = Workspace(tables, tabulate_rewards(task, UNPAID), grid, state, parcels)

    def start(self, seeds: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]:
        """A flight on each map, at its start or anywhere: uint8[N, cells] grids, uint16[N, state size] states."""
        grids = np.zeros((len(seeds), len(self._workspace.grid)), np.uint8)
        states = np.zeros((len(seeds), len(self._workspace.state)), np.uint16)
        start_kernel(self._workspace, int(counts_units(self._task)), seeds, grids, states)
        return grids, states

    def fly(self, seeds: npt.NDArray[np.int64], rng: np.random.Generator) -> Trials:
        """Fly K plans from a state of each map: all choices of the best plans, and as many of the others."""
        seen: list[tuple[npt.NDArray[Any], ...]] = []

        def watch(*choices: npt.NDArray[Any]) -> None:
            seen.append(choices)

        flights = self._planner.fly(*self.start(seeds), seeds, watch)
        flying, grids, states, chosen = map(np.concatenate, zip(*seen, strict=True))
        scores = flights.scores.reshape(-1, self._plans)
        best = np.arange(len(seeds)) * self._plans + scores.argmax(axis=1)
        imitated = np.zeros(scores.size, np.bool_)
        imitated[best] = scores.max(axis=1) > scores.min(axis=1)
        completed = flights.states[:, DELIVERIES_DONE] == self._task.deliveries
        of_best = np.flatnonzero(imitated[flying] & (chosen >= 0))
        others = np.flatnonzero(~imitated[flying] & (chosen >= 0))
        kept = np.concatenate([of_best, rng.permutation(others)[: max(len(of_best), len(seeds))]])
        numbers = states[kept].astype(np.int64)
        grounds = grids[kept]
        grounds[np.arange(len(kept)), numbers[:, CELL]] = numbers[:, UNDER]
        left = self._task.max_steps - numbers[:, STEPS]
        values = COMPLETED * completed[flying[kept]] + IMITATED * imitated[flying[kept]]
        drones = np.stack([numbers[:, CELL], numbers[:, BATTERY], left], axis=1)
        return Trials(grounds, drones, chosen[kept], values.astype(np.float32))

    def samples(self, trials: Trials) -> Samples:
        """The training samples of these choices."""
        parts: list[Features] = []
        for i in range(0, max(len(trials.chosen), 1), self._encoder.most):
            some = slice(i, i + self._encoder.most)
            features = self._encoder.encode(trials.grounds[some], trials.drones[some])
            parts.append(Features(*(array.copy() for array in features)))
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in Features._fields}
        counts = np.concatenate([np.diff(part.begins) for part in parts])
        begins = columns["begins"] = np.append(0, counts.cumsum())
        values = np.full(len(columns["token"]), np.nan, np.float32)
        values[begins[:-1] + trials.chosen] = trials.values
        return Samples(Features(**columns), values)


class RewardTrainer(TourTrainer):
    """One training of a tour network from rewards alone. Arguments and errors are those of `TourTrainer`."""

    def __init__(self, config: TourConfig) -> None:
        super().__init__(config)
        self._trials: list[deque[Trials]] = [deque(maxlen=config.window) for _ in self._windows]

    def _make_sources(self, tasks: list[TaskConfig]) -> None:
        network = partial(self._logits, self.online)
        self._explorers = [Explorer(task, network, self.config.plans) for task in tasks]

    def train(self) -> Iterator[list[TourProgress]]:
        """Fly and train until `config.updates` updates; yields as `TourTrainer.train`."""
        while self.updates < self.config.updates:
            task, (seeds, _) = self._task_of(self.updates), self._seeds_of(self.updates)
            trials = self._explorers[task].fly(seeds, self._rng(self.updates, 3))
            self._trials[task].append(trials)
            self._windows[task].append(self._explorers[task].samples(trials))
            self._update()
            yield self._log()

    def _losses_of(self, preference: Tensor, completion: Tensor, batch: TourBatch) -> tuple[Tensor, Tensor, Tensor]:
        return imitation_losses(preference, completion, batch)

    def get_state(self) -> dict[str, Any]:
        """As `TourTrainer.get_state`, with the last trials."""
        trials = [[[torch.from_numpy(array) for array in one] for one in window] for window in self._trials]
        return super().get_state() | {"trials": trials}

    def set_state(self, state: dict[str, Any]) -> None:
        """As `TourTrainer.set_state`."""
        super().set_state(state)
        for window, trials, explorer, stored in zip(
            self._windows, self._trials, self._explorers, state["trials"], strict=True
        ):
            trials.extend(Trials(*(tensor.numpy() for tensor in one)) for one in stored)
            window.extend(map(explorer.samples, trials))


def imitation_losses(preference: Tensor, completion: Tensor, batch: TourBatch) -> tuple[Tensor, Tensor, Tensor]:
    """Cross-entropy of the imitated choices, NaN for the unknown regrets, and cross-entropy of the completions.

    Args:
        preference: float32[options], the network's preferences.
        completion: float32[options], the logits of whether the mission can be completed after each option.
        batch: The batch, with the values of `Explorer.samples`.
    """
    log_probs = batch.of_options(batch.table(choice_logits(preference, completion), -math.inf).log_softmax(1))
    flown = ~batch.values.isnan()
    imitated = batch.values >= IMITATED
    choice = -(log_probs[imitated].sum() / imitated.sum().clamp(min=1))
    completed = (batch.values[flown] % IMITATED) == COMPLETED
    return choice, torch.tensor(math.nan), binary_cross_entropy_with_logits(completion[flown], completed.float())
