"""Batches of lessons as tensors, and what a tour network has lost on one."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, logsigmoid

from drone_env.agents.tour_view import SHORT_TIME, SMALL_BATTERY, View
from drone_env.rl.lessons import COMPLETE, Lessons

LESSONS = 4
"""How many lessons a batch is of."""
MOST_REGRET = 0.1
"""What expected regret counts at most: a parcel more or less is the completion's matter."""


class Batch:
    """States and their options as tensors.

    Args:
        view: Of the states.
        values: float32[options], what each option is worth.
    """

    def __init__(self, view: View, values: npt.NDArray[np.float32]) -> None:
        counts = np.diff(view.begins)
        owner = np.repeat(np.arange(len(counts)), counts)
        self._size = (len(counts), int(counts.max(initial=1)))
        self._at = (
            torch.from_numpy(owner),
            torch.from_numpy(np.arange(len(owner)) - np.repeat(view.begins[:-1], counts)),
        )
        arrays = (view.tokens, view.present, view.edges, owner, view.token.astype(np.int64), view.features)
        self.inputs = tuple(torch.from_numpy(array) for array in arrays)
        """What the network takes."""
        self.values = torch.from_numpy(values)

    def table(self, values: Tensor, missing: float) -> Tensor:
        """A number for each option as one row for each state, float32[states, most options]."""
        return torch.full(self._size, missing).index_put(self._at, values)

    def of_options(self, table: Tensor) -> Tensor:
        """The numbers of such a table, float32[options]."""
        return table[self._at]


def sample(window: Sequence[Lessons], size: int, random: np.random.Generator) -> Batch:
    """States of four lessons of a window, as many of each.

    Args:
        window: Lessons of one task, none of them empty.
        size: How many states, a multiple of 4.
        random: Chooses them; a lesson or a state can be chosen more than once.
    """
    parts: list[tuple[npt.NDArray[Any], ...]] = []
    lessons = [window[int(random.integers(len(window)))] for _ in range(LESSONS)]
    most = max(view.tokens.shape[1] for view, _ in lessons)
    for view, values in lessons:
        more = (0, most - view.tokens.shape[1])  # tokens that are not there
        chosen = random.integers(0, len(view.tokens), size // LESSONS)
        counts: npt.NDArray[np.int64] = np.diff(view.begins)[chosen]
        shifts: npt.NDArray[np.int64] = view.begins[chosen] - np.cumsum(counts) + counts
        options: npt.NDArray[np.int64] = np.repeat(shifts, counts) + np.arange(int(counts.sum()))
        by_state = (
            np.pad(view.tokens[chosen], ((0, 0), more, (0, 0))),
            np.pad(view.present[chosen], ((0, 0), more)),
            np.pad(view.edges[chosen], ((0, 0), more, more, (0, 0))),
            counts,
        )
        parts.append((*by_state, view.token[options], view.features[options], view.numbers[options], values[options]))
    tokens, present, edges, counts, token, features, numbers, values = map(np.concatenate, zip(*parts, strict=True))
    begins = np.concatenate([[0], np.cumsum(counts)])
    return Batch(View(tokens, present, edges, begins, token, features, numbers), values)


def chosen_by(preference: Tensor, completion: Tensor) -> Tensor:
    """The logits of the choice: an option after which the mission can hardly be completed is hardly chosen."""
    return preference + 2 * logsigmoid(completion)


def losses_of(
    preference: Tensor, completion: Tensor, batch: Batch, temperature: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Cross-entropy of the choices, expected regret, and cross-entropy of the completions: means over a batch.

    Args:
        preference: float32[options], what the network says of each option.
        completion: float32[options], the logit of whether the mission can be completed after it.
        batch: What it was asked.
        temperature: Regret at which the wanted probability has fallen to 1 / e of the best option's.
    """
    logits = batch.table(chosen_by(preference, completion), -math.inf)
    values = batch.table(batch.values, -math.inf)
    regrets = values.amax(1, keepdim=True) - values
    # At most what a step over a road costs: else equal mistakes would count for less where maps are larger.
    drone = batch.inputs[0][:, 0]
    step_cost = drone[:, SMALL_BATTERY] / 100 + drone[:, SHORT_TIME] / 400
    wanted = (-regrets / step_cost.clamp(max=temperature)[:, None]).softmax(1)
    log_chosen = logits.log_softmax(1)
    there = torch.isfinite(values)
    choice = -(wanted * log_chosen.masked_fill(~there, 0)).sum(1).mean()
    regret = (log_chosen.exp() * regrets.clamp(max=MOST_REGRET).masked_fill(~there, 0)).sum(1).mean()
    can_complete = (batch.values >= COMPLETE).float()
    return choice, regret, binary_cross_entropy_with_logits(completion, can_complete)
