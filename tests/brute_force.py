"""What can be made of every state, by trying everything: it knows nothing but the dynamics and the score."""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import compiled, score
from drone_env.core.actions import N_ACTIONS
from drone_env.core.compile_cache import compiled_once
from drone_env.core.rewards import get_reward_profile, tabulate_rewards
from drone_env.core.rules import OUTCOME, tabulate
from drone_env.core.state_manager import Episode, EpisodeState


@compiled_once()
def fly_every_action(
    rules: Any, rewards: Any, grids: Any, rows: Any, next_grids: Any, next_rows: Any, scores: Any
) -> None:
    """Fly all five actions from each of N states into 5 N states."""
    for k in range(len(next_rows)):
        next_grids[k] = grids[k // N_ACTIONS]
        next_rows[k] = rows[k // N_ACTIONS]
        compiled.step(rules, rewards, next_grids[k], next_rows[k], k % N_ACTIONS)
        scores[k] = score.score(rules, next_rows[k])


class BruteForce:
    """Every state that can be reached from an episode, and Q* of each: layer by layer, then back.

    States whose rows are equal are one state: they were flown on one map, and that their grids are equal is asserted.
    """

    def __init__(self, episode: Episode) -> None:
        assert not episode.ended
        self._start = episode.get_state()
        self._first_step = episode.steps
        task = episode.task
        rules, rewards = tabulate(task), tabulate_rewards(task, get_reward_profile("score"))
        grids = np.frombuffer(self._start.grid, np.uint8)[None]
        rows = np.frombuffer(self._start.row, np.uint16)[None]
        self._numbers: list[dict[bytes, int]] = [{self._start.row: 0}]
        self._grids, self._rows = [grids], [rows]
        flights = []
        while len(rows):
            n = N_ACTIONS * len(rows)
            next_grids = np.zeros((n, grids.shape[1]), np.uint8)
            next_rows = np.zeros((n, rows.shape[1]), np.uint16)
            scores = np.zeros(n)
            fly_every_action(rules, rewards, grids, rows, next_grids, next_rows, scores)
            flying = next_rows[:, OUTCOME] == 0
            rows, grids = next_rows[flying], next_grids[flying]
            numbers: dict[bytes, int] = {}
            which = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in rows], np.int64)
            _, first = np.unique(which, return_index=True)
            assert np.array_equal(grids[first][which], grids)
            rows, grids = rows[first], grids[first]
            flights.append((flying, which, scores))
            self._numbers.append(numbers)
            self._rows.append(rows)
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
        self.size = sum(map(len, self._rows))
        """How many states there are."""

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """The highest score that can be reached after each action."""
        t = episode.steps - self._first_step
        return self._q_values[t][self._numbers[t][episode.get_state().row]]

    def state(self, number: int) -> EpisodeState:
        """One of the `size` states, in flight."""
        for rows, grids in zip(self._rows, self._grids, strict=True):
            if number < len(rows):
                row, grid = rows[number].tobytes(), grids[number].tobytes()
                return EpisodeState(
                    self._start.task, self._start.reward_profile, self._start.seed, grid, row, 0.0, 0.0, ()
                )
            number -= len(rows)
        raise IndexError(number)
