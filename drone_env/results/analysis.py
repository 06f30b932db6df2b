"""A flight move by move, as a chess engine would annotate a game: what each move gave away, exactly.

    regret(move) = V*(before it) - V*(after it)

V* is the highest score that can still be reached (`planning.solver`), and after the end of a flight the score itself.
V*(after a) and Q*(before, a) are the same float, since values are only compared and never summed. So every regret is
the difference of two neighbours in `FlightAnalysis.values`, and along the flight the regrets telescope: taken as exact
numbers they add up to optimum - score, with nothing left over. As floats each is rounded once, so their sum may be off
in the last digits; `FlightAnalysis.regret` is therefore optimum - score, rounded once.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.results.record import EpisodeRecord, replay

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

Label = Literal["best", "good", "inaccuracy", "mistake", "blunder"]
LABELS: tuple[Label, ...] = get_args(Label)


SEVERITIES: dict[Label, tuple[float, str]] = {
    "good": (0.0, ""),
    "inaccuracy": (0.008, "?!"),
    "mistake": (0.05, "?"),
    "blunder": (0.5, "??"),
}
"""The smallest regret of each label, in parcels, and its mark; best is a regret of exactly 0.

The unit is what one parcel adds to the score, 0.8 / parcels of the map, so that a label means the same on every task.

- 0.5: a parcel that could be delivered no longer can be. That costs about a whole parcel, but the score is clamped at
  both ends (losing the only parcel may cost 0.793 instead of 0.8), and a task that pays for battery and steps without
  all parcels gives some of it back. A mere detour costs less: even a charge lost in the skyline tasks is below 0.3.
- 0.05: a detour that costs much of the 0.2 for battery and steps: 7 steps on hard, 12 on easy; in the skyline tasks a
  few battery units, which have to be charged again.
- 0.008: one wrong turn, which costs the step there and the step back: 0.0083 parcels on easy, 0.0156 on hard. A single
  step lost is below it on easy, medium and hard (0.0042 to 0.0078).
"""
MARKS: dict[Label, str] = {"best": "", **{label: mark for label, (_, mark) in SEVERITIES.items()}}
ONLY_MOVE = "!!"


def parcel_value(task: TaskConfig) -> float:
    """What one parcel adds to the score."""
    return 0.8 / task.deliveries


def label_of(regret: float, task: TaskConfig) -> Label:
    """What a move with this regret is called, see `SEVERITIES`."""
    if regret == 0:
        return "best"
    parcels = regret / parcel_value(task)
    return next(label for label, (least, _) in reversed(SEVERITIES.items()) if least <= parcels)


@dataclass(frozen=True)
class Move:
    """One move.

    Attributes:
        step: Its number, from 1.
        action: What was flown.
        position: (x, y) after it.
        event: What happened.
        value: V* before it: the highest score that could still be reached.
        regret: What it gave away for good, in score: 0 or more.
        label: The regret in a word.
        best_actions: All actions that give nothing away, by number; the one that was flown is among them if it is best.
        margin: What the next best action gives away, in score; 0 where all five are equally good, so that nothing could
            be lost.
        mark: As beside a move of chess: `?!`, `?` or `??` by the label, `!!` for the only best action where every other
            one is a blunder, else empty.
    """

    step: int
    action: Action
    position: tuple[int, int]
    event: Event
    value: float
    regret: float
    label: Label
    best_actions: tuple[Action, ...]
    margin: float
    mark: str


@dataclass(frozen=True)
class GivingUp:
    """The end of a flight that was not flown to its end: it counts as if it had waited (`Episode.counted_score`).

    Attributes:
        value: V* where the flight stopped: the highest score that could still be reached.
        regret: What giving up gave away, in score: `value` minus the score that waiting to the end earns.
        label: The regret in a word.
        best_actions: All actions with which the flight could have gone on without a loss, by number.
    """

    value: float
    regret: float
    label: Label
    best_actions: tuple[Action, ...]


@dataclass(frozen=True)
class FlightAnalysis:
    """A flight beside the exact values of all its states.

    Attributes:
        task: The task.
        seed: The number of the map.
        agent: Who flew.
        outcome: How the flight stands after its last move.
        score: The score that counts: of an unfinished flight what waiting to its end would earn.
        moves: One entry per move, in order.
        giving_up: What not flying on gave away; None for a flight that has ended.
    """

    task: TaskConfig
    seed: int
    agent: str
    outcome: Outcome
    score: float
    moves: tuple[Move, ...]
    giving_up: GivingUp | None

    @property
    def ended(self) -> bool:
        """Whether the flight was flown to its end."""
        return self.giving_up is None

    @property
    def values(self) -> tuple[float, ...]:
        """V* before each move, V* where an unfinished flight stopped, and the score: none higher than the one before.

        The differences of neighbours are the regrets of the moves and, in an unfinished flight, of giving up: there is
        one value more than regrets.
        """
        stopped = () if self.giving_up is None else (self.giving_up.value,)
        return (*(move.value for move in self.moves), *stopped, self.score)

    @property
    def optimum(self) -> float:
        """V* at the start: the highest score that any flight from there can reach."""
        return self.values[0]

    @property
    def regret(self) -> float:
        """Optimum less score: the exact sum of all regrets, rounded once."""
        return self.optimum - self.score

    @property
    def counts(self) -> dict[Label, int]:
        """Moves by label, all labels."""
        return {label: sum(move.label == label for move in self.moves) for label in LABELS}

    @property
    def decisive(self) -> int:
        """Moves where something could be lost, because not all five actions were equally good."""
        return sum(move.margin > 0 for move in self.moves)

    @property
    def decisive_best(self) -> int:
        """Best moves among the decisive ones."""
        return sum(move.margin > 0 and move.regret == 0 for move in self.moves)

    @property
    def accuracy(self) -> float | None:
        """Share of best moves among the decisive ones, None if there are none.

        The other moves are left out because they would all count as best: a flight on which nothing can be delivered
        any more gives nothing away however it goes on.
        """
        return self.decisive_best / self.decisive if self.decisive else None

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON values; positions are [x, y], actions and events names."""
        giving_up = self.giving_up
        return {
            "task": self.task.id,
            "task_version": self.task.version,
            "seed": self.seed,
            "agent": self.agent,
            "ended": self.ended,
            "outcome": self.outcome.name.lower(),
            "score": self.score,
            "optimum": self.optimum,
            "regret": self.regret,
            "accuracy": self.accuracy,
            "decisive": self.decisive,
            "counts": self.counts,
            "values": list(self.values),
            "moves": [_plain(vars(move)) for move in self.moves],
            "giving_up": giving_up and _plain(vars(giving_up)),
        }

    def to_text(self) -> str:
        """All of it for a terminal or a file: a title, one line per move, the summary."""
        losses = self.moves if self.giving_up is None else (*self.moves, self.giving_up)
        title = f"{self.task.id}, map {self.seed}, flown by {self.agent}"
        return "\n".join([title, "", HEADING, *map(_line, losses), "", *self.summary_lines()])

    def summary_lines(self) -> list[str]:
        """The moves by label and what they lost together, the score beside the optimum, the accuracy."""
        rows: list[tuple[str, str, float, str]] = []
        for label, count in self.counts.items():
            lost = math.fsum(move.regret for move in self.moves if move.label == label)
            rows.append((label, str(count), lost, MARKS[label] if count else ""))
        if self.giving_up is not None:
            rows.append(("giving up", "", self.giving_up.regret, MARKS[self.giving_up.label]))
        lines = [f"{'':<10} {'moves':>6}  {'lost':>7}"]
        lines += [f"{name:<10} {count:>6}  {lost:7.5f}  {mark}".rstrip() for name, count, lost, mark in rows]
        lines += ["", f"Score {self.score:.4f}, optimum {self.optimum:.4f}, regret {self.regret:.5f}"]
        if self.giving_up is not None:
            lines.append(f"Unfinished after {len(self.moves)} steps: counted as if it had waited to the end")
        if self.accuracy is None:
            lines.append("Accuracy -: there was no move on which anything could be lost")
        else:
            best = f"{self.decisive_best} best moves of {self.decisive}"
            lines.append(f"Accuracy {self.accuracy:.1%}: {best} on which anything could be lost")
        return lines


HEADING = f"{'step':>4}  {'move':<8} {'to':>8}  {'event':<12}  {'value':>6}  {'regret':>7}  better"
"""The heading of the moves; `value` is `Move.value`."""


def analyse_flight(record: EpisodeRecord, solver_from: "Callable[[Episode], Solver] | None" = None) -> FlightAnalysis:
    """The regret of every move of a recorded flight, which is flown again and checked first.

    Args:
        record: The flight.
        solver_from: As of `analyse_actions`.

    Raises:
        UnknownNameError: if there is no such task, version or reward profile.
        InvalidValueError: if the record does not fit its flight.
        TooLargeError: if the exact values of the map would take too much memory.
    """
    flown = replay(record, "score")  # regret is in score, not in what the steps paid
    start = Episode(flown.task, flown.reward_profile, flown.seed)
    return analyse_actions(start, flown.actions, record.agent, solver_from)


def analyse_actions(
    start: Episode, actions: Iterable[int], agent: str, solver_from: "Callable[[Episode], Solver] | None" = None
) -> FlightAnalysis:
    """The regret of every one of `actions`, flown from where an episode stands; the episode is left as it is.

    Args:
        start: In flight.
        actions: Of which none comes after the end.
        agent: Who flew.
        solver_from: Gives the solver of an episode, which may have been made before; None to make one.

    Raises:
        EpisodeError: if the episode has not begun, or there are actions after its end.
        InvalidValueError: if an action is not an integer from 0 to 4.
        TooLargeError: if the exact values of the map would take too much memory.
    """
    if solver_from is None:
        from drone_env.planning.optimal import solver_of  # loads Numba

        solver_from = solver_of
    solver = solver_from(start)
    flight = start.copy()
    moves: list[Move] = []
    for action in actions:
        values = solver.q_values(flight).tolist()
        flight.step(action)
        moves.append(_move(flight, values))
    giving_up = None
    score = flight.counted_score()
    if not flight.ended:
        value = solver.value(flight)
        regret = value - score
        giving_up = GivingUp(value, regret, label_of(regret, start.task), solver.optimal_actions(flight))
    return FlightAnalysis(start.task, start.seed, agent, flight.outcome, score, tuple(moves), giving_up)


def _move(flight: Episode, values: list[float]) -> Move:
    """The last step of `flight`, before which Q* was `values`."""
    step = flight.last_step
    assert step is not None
    best = max(values)
    regret = best - values[step.action]
    margin = best - max((value for value in values if value < best), default=best)
    label = label_of(regret, flight.task)
    best_actions = tuple(action for action in Action if values[action] == best)
    only = best_actions == (step.action,) and label_of(margin, flight.task) == "blunder"
    return Move(
        step=flight.steps,
        action=step.action,
        position=(step.x, step.y),
        event=step.event,
        value=best,
        regret=regret,
        label=label,
        best_actions=best_actions,
        margin=margin,
        mark=ONLY_MOVE if only else MARKS[label],
    )


def _line(lost: Move | GivingUp) -> str:
    """One line below `HEADING`."""
    if isinstance(lost, Move):
        move, mark, event = lost.action.name, lost.mark, lost.event.name.lower()
        number, to = str(lost.step), str(lost.position)
    else:
        move, mark, event = "stop", MARKS[lost.label], "unfinished"
        number, to = "", ""
    regret, better = "", ""
    if lost.regret > 0:
        regret, better = f"{lost.regret:.5f}", ", ".join(action.name for action in lost.best_actions)
    return (
        f"{number:>4}  {f'{move:<5} {mark}':<8} {to:>8}  {event:<12}  {lost.value:6.4f}  {regret:>7}  {better}".rstrip()
    )


def _plain(value: Any) -> Any:
    """As a JSON value: actions and events by their names."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in cast(dict[str, Any], value).items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in cast(tuple[Any, ...], value)]
    if isinstance(value, Action):
        return value.name
    return value.name.lower() if isinstance(value, Event) else value
