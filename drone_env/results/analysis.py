"""The exact regret of each move of a flight, annotated like a chess game.

    regret(move) = V*(before) - V*(after)

V* is the highest score that is still attainable (`planning.solver`); after the end it is the score. V*(after a) and
Q*(before, a) are the same float, since values are compared and never summed. So every regret is the difference of two
neighbours in `FlightAnalysis.values`, and the exact regrets of an ended flight add up to optimum - score. Each float is
rounded once, so their sum may differ in the last digits; `FlightAnalysis.regret` is optimum - score, rounded once.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.cells import CELL_KINDS
from drone_env.core.episode import Episode, EpisodeState, PathStep, rollout
from drone_env.core.rules import score_of
from drone_env.core.tables import interpreted
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.flights.record import EpisodeRecord, replay

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

Label = Literal["best", "good", "inaccuracy", "mistake", "blunder"]
STATES_AT_ONCE = 256
"""Number of states whose values are computed together."""


SEVERITIES: dict[Label, tuple[float, str]] = {
    "good": (0.0, ""),
    "inaccuracy": (0.008, "?!"),
    "mistake": (0.05, "?"),
    "blunder": (0.5, "??"),
}
"""The smallest regret of each label, in parcels, and its mark. The label "best" means a regret of exactly 0.

One parcel adds 0.8 / (parcels of the map) to the score; this unit gives a label the same meaning on every task.

- 0.5: a parcel can no longer be delivered. That costs about one parcel, but less if the score is clamped (0.793
  instead of 0.8 for an only parcel) or the task pays for battery and steps without all parcels. A detour costs less:
  a lost charge in the skyline tasks costs below 0.3.
- 0.05: a detour that costs much of the 0.2 for battery and steps: 7 steps on hard, 12 on easy. In the skyline tasks, a
  few battery units that must be charged again.
- 0.008: one wrong turn, which costs two steps: 0.0083 parcels on easy, 0.0156 on hard. A single lost step is below it
  on easy, medium and hard (0.0042 to 0.0078).
"""
MARKS: dict[Label, str] = {"best": "", **{label: mark for label, (_, mark) in SEVERITIES.items()}}
ONLY_MOVE = "!!"
LONGEST_ROUND = 12
"""Actions of the longest round of a loop that `find_loops` looks for."""
LEAST_ROUNDS, LEAST_LOOP = 3, 6
"""The fewest rounds and steps of a loop: a shorter one may be an accident."""


def parcel_value(task: TaskConfig) -> float:
    """Return the score of one parcel."""
    return 0.8 / task.deliveries


def label_of(regret: float, task: TaskConfig) -> Label:
    """Return the label of a regret, see `SEVERITIES`."""
    if regret == 0:
        return "best"
    parcels = regret / parcel_value(task)
    return next(label for label, (least, _) in reversed(SEVERITIES.items()) if least <= parcels)


@dataclass(frozen=True)
class Move:
    """One move.

    Attributes:
        step: Its number, from 1.
        action: The action.
        value: V* before the move, the highest attainable score.
        regret: The loss of score, 0 or more.
        label: The label of the regret.
        best_actions: All actions without regret, by number.
        margin: The regret of the second-best action; 0 if all five actions are equally good.
        mark: `?!`, `?` or `??` by the label; `!!` for the only best action if all others are blunders; else empty.
    """

    step: int
    action: Action
    value: float
    regret: float
    label: Label
    best_actions: tuple[Action, ...]
    margin: float
    mark: str

    @property
    def first(self) -> int:
        """Its number: a move is a span of one step, beside loops of several."""
        return self.step

    @property
    def last(self) -> int:
        """The same number."""
        return self.step


@dataclass(frozen=True)
class Loop:
    """Steps that repeat the same actions over the same cells and deliver nothing.

    Attributes:
        first: The first step, from 1.
        last: The last step, which ends a round.
        actions: The actions of one round.
        words: What the drone did: `circled a pad for 63 steps`.
        idle: Steps after which the battery was no fuller than before in this loop.
        regret: The loss of score of all these moves; None if the map is not solved.
        label: The label of the regret.
        mark: `?!`, `?` or `??` by the label, else empty.
    """

    first: int
    last: int
    actions: tuple[Action, ...]
    words: str
    idle: int
    regret: float | None = None
    label: Label | None = None
    mark: str = ""


@dataclass(frozen=True)
class FlightAnalysis:
    """A flight with the exact value of each state.

    Attributes:
        task: The task.
        seed: The map.
        score: The graded score; for an unfinished flight, the score after waiting to the end.
        moves: One entry per move, in order.
        values: V* before each move and after the last one, where it is the score if the flight has ended. They never
            rise, and the regrets are the differences of neighbours.
        flown: The flight after its last move.
        solver: The exact values of its map.
    """

    task: TaskConfig
    seed: int
    score: float
    moves: tuple[Move, ...]
    values: tuple[float, ...]
    flown: Episode = field(repr=False, compare=False)
    solver: "Solver" = field(repr=False, compare=False)

    @property
    def optimum(self) -> float:
        """V* at the start, the highest attainable score."""
        return self.values[0]

    @property
    def regret(self) -> float:
        """Optimum - score."""
        return self.optimum - self.score

    @property
    def rescue_step(self) -> int | None:
        """The last step after which all parcels could still be delivered; None if there is none, or if it is unknown.

        It is unknown for a task in which a failed flight may score as much as one that delivers all parcels.
        """
        task, tables = self.task, interpreted(self.task)
        n, full = task.deliveries, task.battery_capacity
        least = score_of(tables, n, 0, task.max_steps)
        # A flight fails without battery or without steps.
        failed = max(score_of(tables, n - 1, 0, 0), score_of(tables, n - 1, full, task.max_steps))
        known = failed < least <= self.optimum
        return sum(value >= least for value in self.values) - 1 if known else None

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The loops of the flight, each with the sum of its regrets."""
        values, loops, before = self.values, list[Loop](), self.flown.steps - len(self.moves)
        for loop in find_loops(self.flown, before):
            regret = values[loop.first - 1 - before] - values[loop.last - before]
            label = label_of(regret, self.task)
            loops.append(replace(loop, regret=regret, label=label, mark=MARKS[label]))
        return tuple(loops)

    @cached_property
    def worst(self) -> Move | Loop | None:
        """The move or the whole loop that lost most, the first of equals; None if nothing was lost."""
        worst = max((*self.loops, *self.moves), key=lambda one: one.regret or 0, default=None)
        return worst if worst and worst.regret else None

    @property
    def worst_why(self) -> str:
        """What the drone did wrong in `worst`: `LEFT saves 2 steps`, `circled a pad for 63 steps`; empty without it."""
        worst = self.worst
        if worst is None or isinstance(worst, Loop):
            return "" if worst is None else worst.words
        before = self.flown.actions[: worst.step - 1]

        def end(action: Action) -> Episode:
            flight = Episode(self.task, seed=self.seed).fly([*before, action])
            return rollout(flight, lambda _: self.solver.optimal_actions(flight)[0])

        best, flown = end(worst.best_actions[0]), end(worst.action)
        names = " or ".join(action.name for action in worst.best_actions)
        if best.deliveries_done > flown.deliveries_done:
            reach = f"{best.deliveries_done} of {self.task.deliveries}"
            return f"{names} keeps {reach} parcels in reach, not {flown.deliveries_done}"
        steps, units = flown.steps - best.steps, best.battery_units - flown.battery_units
        gains = (("saves", steps, "step"), ("leaves", units, "more battery unit"))
        return f"{names} {' and '.join(f'{gain} {n} {what}' + 's' * (n > 1) for gain, n, what in gains if n > 0)}"

    @property
    def why(self) -> str:
        """Why the flight failed, in one sentence; empty if it delivered all parcels or goes on."""
        why = why_failed(self.flown, self.worst)
        return "No flight over this map scores more." if why and self.regret == 0 else why


def analyse_flight(record: EpisodeRecord, solver_from: "Callable[[Episode], Solver] | None" = None) -> FlightAnalysis:
    """Verify a recorded flight and return the regret of every move.

    Args:
        record: The flight.
        solver_from: As in `analyse_actions`.

    Raises:
        UnknownNameError: if there is no such task, version or reward profile.
        InvalidValueError: if the record does not fit its flight.
        TooLargeError: if the exact values of the map would take too much memory.
    """
    flown = replay(record, "score")  # regret is in score, not in what the steps paid
    start = Episode(flown.task, flown.reward_profile, flown.seed)
    return analyse_actions(start, flown.actions, solver_from)


def analyse_actions(
    start: Episode, actions: Iterable[int], solver_from: "Callable[[Episode], Solver] | None" = None
) -> FlightAnalysis:
    """Return the regret of every action, flown from the state of an episode, which is not changed.

    Args:
        start: An episode that has not ended.
        actions: The actions.
        solver_from: Returns the solver of an episode; None to create one.

    Raises:
        EpisodeError: if the episode has not begun, or there are actions after its end.
        InvalidValueError: if an action is not an integer from 0 to 4.
        TooLargeError: if the exact values of the map would take too much memory.
    """
    if solver_from is None:
        from drone_env.planning.optimal import solver_of  # loads Numba

        solver_from = solver_of
    solver, flight, flown = solver_from(start), start.copy(), list(actions)
    moves: list[Move] = []
    for first in range(0, len(flown), STATES_AT_ONCE):
        before: list[EpisodeState] = []
        for action in flown[first : first + STATES_AT_ONCE]:
            if flight.ended:
                raise EpisodeError("the episode has ended: it has no further actions")
            before.append(flight.get_state())
            flight.step(action)
        grids = np.array([np.frombuffer(state.grid, np.uint8) for state in before])
        states = np.array([np.frombuffer(state.numbers, np.uint16) for state in before])
        values, path = solver.q_values_of(grids, states).tolist(), flight.path[-len(before) :]
        number = flight.steps - len(before)
        moves += [_move(start.task, number + i, *of) for i, of in enumerate(zip(path, values, strict=True), 1)]
    score = flight.counted_score()
    last = score if flight.ended else solver.value(flight)
    found = (*(move.value for move in moves), last)
    return FlightAnalysis(start.task, start.seed, score, tuple(moves), found, flight, solver)


def find_loops(flown: Episode, after: int = 0) -> tuple[Loop, ...]:
    """Return the loops of a flight in order. Waiting for a full battery is one, too.

    Args:
        flown: The flight.
        after: Number of its first steps that are left out.
    """
    from drone_env.planning.cell_states import charging_pads  # loads Numba

    path, pads, loops, at = flown.path, set(charging_pads(flown)), list[Loop](), after
    # A delivery is never repeated.
    keys = [(i,) if one.event is Event.DELIVERY else (one.action, one.x, one.y) for i, one in enumerate(path)]
    while at < len(path):
        length, shortest = max((_repeated(keys, at, size), -size) for size in range(1, LONGEST_ROUND + 1))
        if length < LEAST_LOOP:
            at += 1
            continue
        steps = path[at : at + length]
        cells = {step.y * flown.task.width + step.x for step in steps}
        if len(cells) == 1 and steps[0].action is not Action.WAIT:
            did = "flew against an edge or an obstacle"
        elif cells & pads:
            did = "stayed on a pad" if len(cells) == 1 else "circled a pad"
        else:
            did = {1: "stayed on one cell", 2: "flew back and forth"}.get(len(cells), "flew in circles")
        units = [step.battery for step in steps]
        idle = length - 1 - units.index(max(units))
        one_round = tuple(step.action for step in steps[:-shortest])
        loops.append(Loop(at + 1, at + length, one_round, f"{did} for {length} steps", idle))
        at += length
    return tuple(loops)


def _repeated(keys: Sequence[object], first: int, period: int) -> int:
    """The number of steps from `first` on that repeat their first `period` ones, in whole rounds; 0 for too few."""
    last = first + period
    while last < len(keys) and keys[last] == keys[last - period]:
        last += 1
    rounds = (last - first) // period
    return rounds * period if rounds >= LEAST_ROUNDS else 0


def why_failed(flown: Episode, worst: Move | Loop | None = None) -> str:
    """Return why an ended flight failed, in one sentence; empty if it delivered all parcels or goes on.

    Args:
        flown: The flight.
        worst: What lost most. A loop is the reason, not the last step.
    """
    from drone_env.planning.cell_states import charging_pads  # loads Numba

    if flown.outcome not in (Outcome.OUT_OF_STEPS, Outcome.BATTERY_DEAD):
        return ""
    ran_out = flown.outcome is Outcome.OUT_OF_STEPS
    if isinstance(worst, Loop):
        end = "the steps ran out" if ran_out else "the battery was empty"
        return f"The drone {worst.words} ({worst.first} to {worst.last}); then {end}."
    task, pads = flown.task, charging_pads(flown)
    if ran_out:
        return f"The steps ran out: a flight has {task.max_steps}."
    grid = Episode(task, seed=flown.seed).grid()
    below = {int(grid[step.y, step.x]) for step in flown.path}
    costly = {CELL_KINDS[kind].name: units for kind, units in task.drain if units > 1 and kind in below}
    costs = " and ".join(f"{kind}s cost {units} units" for kind, units in costly.items()) or "each step costs a unit"
    x, y = flown.position
    away = min((abs(x - pad % task.width) + abs(y - pad // task.width) for pad in pads), default=None)
    if away is None:
        return f"{costs.capitalize()}."
    distance = f"a pad was {away} {'cell' if away == 1 else 'cells'} away"
    reached = [(step.x, step.y) for step in flown.path[-2:]].count((x, y)) == 1
    here = "the drone reached a pad with an empty battery" if reached else "the drone was on a pad and did not wait"
    return f"{costs.capitalize()}; {distance if away else here}."


def _move(task: TaskConfig, number: int, step: PathStep, values: list[float]) -> Move:
    """Return a step of a flight; `values` is Q* before it."""
    best = max(values)
    regret = best - values[step.action]
    margin = best - max((value for value in values if value < best), default=best)
    label = label_of(regret, task)
    best_actions = tuple(action for action in Action if values[action] == best)
    only = best_actions == (step.action,) and label_of(margin, task) == "blunder"
    return Move(
        step=number,
        action=step.action,
        value=best,
        regret=regret,
        label=label,
        best_actions=best_actions,
        margin=margin,
        mark=ONLY_MOVE if only else MARKS[label],
    )
