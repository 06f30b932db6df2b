"""Whole plans of the tour network, flown in the simulator to find the best of K."""

from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_encoder import FeatureEncoder
from drone_env.agents.tour_features import PathSearch, make_search, search_paths
from drone_env.agents.tournet import Network, best_options
from drone_env.core.actions import FLYING, Action
from drone_env.core.cells import DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import kernel
from drone_env.core.rewards import Rewards, get_reward_profile, tabulate_rewards
from drone_env.core.rules import score, step
from drone_env.core.seeds import MASK32, map_key, mix64, next_key, task_key
from drone_env.core.tables import BATTERY, CELL, OUTCOME, PARCELS, STEPS, UNDER
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import NO_STOP

WAIT = int(Action.WAIT)
KEY = task_key("agent/tournet-search", 1)
TEMPERATURES = 0.7, 2.0
"""Sampling temperatures. Half of the plans after the eighth use the second: if the network is sure and wrong, no number
of plans at the first would leave its path."""
FLIGHTS = 2048
"""Maximum number of flights at a time."""


class Flights(NamedTuple):
    """N flights of one task."""

    grids: Any
    """uint8[N, cells]"""
    states: Any
    """uint16[N, state size]"""
    actions: Any
    """int8[N, max_steps], the flown actions by step, padded with WAIT."""
    scores: Any
    """float64[N], the current graded scores."""


class Choices(NamedTuple):
    """The concatenated options of M states."""

    begins: Any
    """int64[M + 1], index of the first option of each state."""
    options: Any
    """int32[options, 4]: token, units, steps, first action."""
    logits: Any
    """float32[options]"""
    best: Any
    """int64[M], index of the best option of each state, -1 if there is none."""


@kernel
def fly_kernel(search: PathSearch, rewards: Rewards, flights: Flights, chosen: Any, options: Any) -> None:
    """Fly paths to their ends by the rules.

    Args:
        search: Working memory, for a single stop.
        rewards: The table of any profile; unused.
        flights: The flights.
        chosen: int64[n], the indices of the flights that move.
        options: int64[n, 4], their paths: token, units, steps, first action; with 0 steps, the flight waits to its
            end.
    """
    tables, ground, stop_at, paths = search.tables, search.ground, search.stop_at, search.paths
    for c in range(tables.cells):
        stop_at[c] = NO_STOP
    for k in range(len(chosen)):
        i = chosen[k]
        grid, state = flights.grids[i], flights.states[i]
        token, units, steps, action = options[k]
        while steps == 0 and state[OUTCOME] == FLYING:
            step(tables, rewards, grid, state, WAIT)
        to = state[CELL]
        if steps > 1:
            for c in range(tables.cells):
                ground[c] = grid[c]
            ground[state[CELL]] = state[UNDER]
            # Tokens are in reading order: the drone, the parcels that wait, the pads.
            for kind in (DELIVERY_CELL, PAD_CELL):
                for c in range(tables.cells):
                    if ground[c] == kind:
                        token -= 1
                        if token == 0:
                            to = c
            stop_at[to] = 0
        while state[OUTCOME] == FLYING:
            before = state[BATTERY] * 1
            flights.actions[i, state[STEPS]] = action
            step(tables, rewards, grid, state, action)
            units -= before - state[BATTERY]
            steps -= 1
            if steps <= 0:
                break
            # The search skips paths that cost more than the rest of this one; one of the others has its steps.
            most = min(units + 1, state[BATTERY])
            search_paths(search, state[CELL], most)
            for k in range(paths.count[0]):
                if paths.steps[0, k] == steps:
                    action = paths.first[0, k]
        stop_at[to] = NO_STOP
        flights.scores[i] = score(tables, state)


class TourPlanner:
    """Plans by the tour network, flown in the simulator.

    Args:
        task: The task.
        network: Chooses the paths.
        plans: K, the number of plans for each map: the first takes the best paths, the others are sampled.
    """

    def __init__(self, task: TaskConfig, network: Network, plans: int) -> None:
        self._network, self._plans = network, plans
        self._encoder = FeatureEncoder(task)
        self._search, self._rewards = make_search(task, 1), tabulate_rewards(task, get_reward_profile("score"))

    def best(
        self, grids: npt.NDArray[np.uint8], states: npt.NDArray[np.uint16], seeds: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int8]:
        """The actions of the plan with the highest score, the first of equal ones, by step: int8[M, max_steps].

        Args:
            grids: uint8[M, cells], of episodes in flight.
            states: uint16[M, state size]
            seeds: int64[M], the agent seeds; the steps flown vary them.
        """
        together = max(1, FLIGHTS // self._plans)
        parts: list[npt.NDArray[np.int8]] = []
        for i in range(0, len(grids), together):
            some = slice(i, i + together)
            flights = self.fly(grids[some], states[some], seeds[some])
            scores = flights.scores.reshape(-1, self._plans)
            actions = flights.actions.reshape(*scores.shape, -1)
            parts.append(actions[np.arange(len(scores)), scores.argmax(axis=1)])
        return np.concatenate(parts)

    def fly(
        self, grids: npt.NDArray[np.uint8], states: npt.NDArray[np.uint16], seeds: npt.NDArray[np.int64]
    ) -> Flights:
        """All plans, flown to their ends, K for each of M states.

        Args:
            grids: uint8[M, cells], of episodes in flight.
            states: uint16[M, state size]
            seeds: int64[M], the agent seeds; the steps flown vary them.
        """
        m, plans, max_steps = len(grids), self._plans, self._search.tables.max_steps
        maps, numbers = np.divmod(np.arange(m * plans), plans)
        actions, scores = np.full((m * plans, max_steps), WAIT, np.int8), np.zeros(m * plans)
        flights = Flights(grids[maps], states[maps], actions, scores)
        # Arrays of 64-bit integers wrap like compiled integers.
        of_maps, steps, of_plans = (cast(Any, array) for array in (seeds[maps], states[maps, STEPS], numbers))
        keys: Any = mix64(map_key(KEY, of_maps) ^ steps ^ mix64(of_plans))
        flying = np.flatnonzero(flights.states[:, OUTCOME] == FLYING)
        while len(flying):
            choices, of = self._choices(maps[flying], flights.grids[flying], flights.states[flying])
            keys = next_key(keys)
            number = numbers[flying]
            warm, hot = (sample_options(choices, of, keys[flying], temperature) for temperature in TEMPERATURES)
            chosen = np.where(number == 0, choices.best[of], np.where(is_hot(number), hot, warm))
            options = np.zeros((len(flying), 4), np.int64)
            options[chosen >= 0] = choices.options[chosen[chosen >= 0]]
            fly_kernel(self._search, self._rewards, flights, flying, options)
            flying = flying[flights.states[flying, OUTCOME] == FLYING]
        return flights

    def _choices(
        self, maps: npt.NDArray[np.int64], grids: npt.NDArray[np.uint8], states: npt.NDArray[np.uint16]
    ) -> tuple[Choices, npt.NDArray[np.int64]]:
        """The options of the distinct states, and the index of each state among these, int64[N]."""
        equal = np.column_stack([maps, states[:, [CELL, BATTERY, STEPS]], states[:, PARCELS:]]).astype(np.int32)
        _, which, of = np.unique(equal, axis=0, return_index=True, return_inverse=True)
        max_steps = self._search.tables.max_steps
        grids, now = grids[which], states[which].astype(np.int64)
        grids[np.arange(len(grids)), now[:, CELL]] = now[:, UNDER]
        drones = np.stack([now[:, CELL], now[:, BATTERY], max_steps - now[:, STEPS]], axis=1)
        parts: list[Choices] = []
        begin = 0
        for i in range(0, len(grids), self._encoder.most):
            some = slice(i, i + self._encoder.most)
            features = self._encoder.encode(grids[some], drones[some])
            logits, _ = self._network(features)
            first = best_options(features, logits)
            options = np.column_stack([features.token, features.numbers])
            best = np.where(first < 0, -1, first + begin)
            parts.append(Choices(features.begins[:-1] + begin, options, logits, best))
            begin += len(options)
        begins, *others = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return Choices(np.append(begins, begin), *others), of.ravel()


def is_hot(numbers: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Whether the plans of these numbers use the second temperature."""
    return (numbers >= 8) & (numbers % 2 == 1)


def sample_options(choices: Choices, of: npt.NDArray[np.int64], keys: Any, temperature: float) -> npt.NDArray[np.int64]:
    """Sample an option of each state by the softmax of its logits / temperature; -1 if there is none.

    Args:
        choices: Of M states.
        of: int64[n], the states to sample for.
        keys: int64[n], the random keys.
        temperature: Above 0; the higher, the closer to uniform.
    """
    counts = np.diff(choices.begins)
    highest = np.repeat(choices.logits[choices.best], counts) if len(choices.logits) else choices.logits
    likely = np.exp((choices.logits - highest) / temperature, dtype=np.float64)
    sums = np.concatenate([[0.0], likely.cumsum()])
    below, above = sums[choices.begins[of]], sums[choices.begins[of + 1]]
    share = (mix64(keys) >> 32 & MASK32) / (MASK32 + 1)
    found = np.searchsorted(sums, below + share * (above - below), side="right") - 1
    found = np.clip(found, choices.begins[of], choices.begins[of + 1] - 1)
    return np.where(counts[of] > 0, found, -1)
