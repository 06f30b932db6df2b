"""What can be made of every state, by trying everything: it knows nothing but the dynamics and the score."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import compiled, rules
from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode, EpisodeState
from drone_env.core.rewards import get_reward_profile, tabulate_rewards
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    OUTCOME,
    PARCELS,
    STEPS,
    UNDER,
    tabulate,
)


@compiled_once()
def fly_every_action(
    tables: Any, rewards: Any, grids: Any, states: Any, next_grids: Any, next_states: Any, scores: Any
) -> None:
    """Fly all five actions from each of N states into 5 N states."""
    for k in range(len(next_states)):
        next_grids[k] = grids[k // N_ACTIONS]
        next_states[k] = states[k // N_ACTIONS]
        compiled.step(tables, rewards, next_grids[k], next_states[k], k % N_ACTIONS)
        scores[k] = rules.score(tables, next_states[k])


def best_score(start: Episode) -> float:
    """The highest score that a new episode can reach, step by step: the optimum without paths, stops or values.

    Of two flights with equal steps, deliveries and cell, one with more battery can do whatever the other can. So it is
    enough to know the most units at each step, delivered set and cell.
    """
    task, parcels = start.task, [y * start.task.width + x for x, y, _ in start.parcels]
    tables, rewards = tabulate(task), tabulate_rewards(task, get_reward_profile("score"))
    bits = 1 << np.arange(len(parcels))
    done = np.arange(1 << len(parcels))[:, None] & bits > 0
    ground = start.grid().ravel()
    ground[start.cell] = start.under
    grids = np.repeat(ground[None], len(done), axis=0)
    grids[:, parcels] = np.where(done, DELIVERED_CELL, DELIVERY_CELL)
    states = np.repeat(np.frombuffer(start.get_state().numbers, np.uint16)[None], len(done), axis=0)
    states[:, PARCELS:] += np.uint16(DELIVERED_FLAG) * done
    states[:, DELIVERIES_DONE] = done.sum(axis=1)
    most = np.zeros(grids.shape, np.uint16)
    most[0, start.cell] = start.battery_units
    best = 0.0
    for steps in range(task.max_steps):
        delivered, cells = np.nonzero(most)
        now, seen, rows = states[delivered], grids[delivered], np.arange(len(cells))
        now[:, CELL], now[:, UNDER] = cells, seen[rows, cells]
        now[:, STEPS], now[:, BATTERY] = steps, most[delivered, cells]
        seen[rows, cells] = DRONE_CELL
        flown, scores = np.zeros((N_ACTIONS * len(now), now.shape[1]), np.uint16), np.zeros(N_ACTIONS * len(now))
        fly_every_action(tables, rewards, seen, now, np.zeros((len(flown), len(ground)), np.uint8), flown, scores)
        flying = flown[:, OUTCOME] == 0
        best = max(best, scores[~flying].max(initial=0.0))
        flown = flown[flying]
        most = np.zeros_like(most)
        np.maximum.at(most, ((flown[:, PARCELS:] >= DELIVERED_FLAG) @ bits, flown[:, CELL]), flown[:, BATTERY])
    return best


class BruteForce:
    """Every state that can be reached from an episode, and Q* of each: layer by layer, then back.

    States whose rows are equal are one state: they were flown on one map, and that their grids are equal is asserted.
    """

    def __init__(self, episode: Episode) -> None:
        assert not episode.ended
        self._start = episode.get_state()
        self._first_step = episode.steps
        task = episode.task
        tables, rewards = tabulate(task), tabulate_rewards(task, get_reward_profile("score"))
        # Copies: for arrays that cannot be written, the kernel would be compiled once more.
        grids = np.frombuffer(self._start.grid, np.uint8)[None].copy()
        states = np.frombuffer(self._start.numbers, np.uint16)[None].copy()
        self._numbers: list[dict[bytes, int]] = [{self._start.numbers: 0}]
        self._grids, self._states = [grids], [states]
        flights = []
        while len(states):
            n = N_ACTIONS * len(states)
            next_grids = np.zeros((n, grids.shape[1]), np.uint8)
            next_states = np.zeros((n, states.shape[1]), np.uint16)
            scores = np.zeros(n)
            fly_every_action(tables, rewards, grids, states, next_grids, next_states, scores)
            flying = next_states[:, OUTCOME] == 0
            states, grids = next_states[flying], next_grids[flying]
            numbers: dict[bytes, int] = {}
            which = np.array([numbers.setdefault(state.tobytes(), len(numbers)) for state in states], np.int64)
            _, first = np.unique(which, return_index=True)
            assert np.array_equal(grids[first][which], grids)
            states, grids = states[first], grids[first]
            flights.append((flying, which, scores))
            self._numbers.append(numbers)
            self._states.append(states)
            self._grids.append(grids)
        self._q_values: list[npt.NDArray[np.float64]] = []
        values = np.zeros(0)
        for flying, which, scores in reversed(flights):
            scores[flying] = values[which]
            self._q_values.append(np.reshape(scores, (-1, N_ACTIONS)))
            values = self._q_values[-1].max(axis=1)
        self._q_values.reverse()
        self.value = float(values[0])
        """The highest score that can be reached from the start."""
        self.size = sum(map(len, self._states))
        """How many states there are."""

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """The highest score that can be reached after each action."""
        t = episode.steps - self._first_step
        return self._q_values[t][self._numbers[t][episode.get_state().numbers]]

    def state(self, number: int) -> EpisodeState:
        """One of the `size` states, in flight."""
        for states, grids in zip(self._states, self._grids, strict=True):
            if number < len(states):
                state, grid = states[number].tobytes(), grids[number].tobytes()
                return replace(self._start, grid=grid, numbers=state, reward_total=0.0, path=())
            number -= len(states)
        raise IndexError(number)
