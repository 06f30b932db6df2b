"""What can be made of every state, by trying everything: it knows nothing but the dynamics and the score."""

from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS
from drone_env.core.batch import Batch
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL
from drone_env.core.episode import Episode, EpisodeState
from drone_env.core.tables import BATTERY, CELL, DELIVERED_FLAG, DELIVERIES_DONE, OUTCOME, PARCELS, STEPS, UNDER
from drone_env.core.tasks import TaskConfig

Array: TypeAlias = npt.NDArray[Any]


def fly_every_action(task: TaskConfig, grids: Array, states: Array) -> tuple[Array, Array, Array]:
    """Fly all five actions from each of N states: 5 N grids and states, and the scores of those that have ended."""
    batch = Batch(task, N_ACTIONS * len(states), "score")
    buffers = batch._buffers
    buffers.grids[:], buffers.states[:] = (np.repeat(rows, N_ACTIONS, axis=0) for rows in (grids, states))
    batch.started = True
    batch.step(np.tile(np.arange(N_ACTIONS), len(states)))
    scores = np.zeros(batch.num_envs)
    scores[batch.ended] = batch.finals()["score"]
    return buffers.grids, buffers.states, scores


def best_score(start: Episode) -> float:
    """The highest score that a new episode can reach, step by step: the optimum without paths, stops or values.

    Of two flights with equal steps, deliveries and cell, one with more battery can do whatever the other can. So it is
    enough to know the most units at each step, delivered set and cell.
    """
    task, parcels = start.task, [y * start.task.width + x for x, y, _ in start.parcels]
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
        if not len(cells):
            break
        now, seen, rows = states[delivered], grids[delivered], np.arange(len(cells))
        now[:, CELL], now[:, UNDER] = cells, seen[rows, cells]
        now[:, STEPS], now[:, BATTERY] = steps, most[delivered, cells]
        seen[rows, cells] = DRONE_CELL
        _, flown, scores = fly_every_action(task, seen, now)
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
        grids = np.frombuffer(self._start.grid, np.uint8)[None]
        states = np.frombuffer(self._start.numbers, np.uint16)[None]
        self._numbers: list[dict[bytes, int]] = [{self._start.numbers: 0}]
        self._grids, self._states = [grids], [states]
        flights = []
        while len(states):
            grids, states, scores = fly_every_action(episode.task, grids, states)
            flying = states[:, OUTCOME] == 0
            states, grids = states[flying], grids[flying]
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
