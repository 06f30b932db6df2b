"""What a prompt tells, read from its text alone: the task, how its flights are scored, and where the drone stands."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.standing import standing_episode
from drone_env.core.tasks import TaskConfig
from drone_env.llm.prompt import ChatMessage

KINDS = {
    "road": Cell.ROAD,
    "building": Cell.BUILDING,
    "tree": Cell.TREE,
    "obstacle": Cell.OBSTACLE,
    "parcel to deliver": Cell.DELIVERY,
    "delivered": Cell.DELIVERED,
    "delivered parcel": Cell.DELIVERED,
    "charging pad": Cell.PAD,
}
TITLES = {
    "Parcels to deliver": Cell.DELIVERY,
    "Buildings": Cell.BUILDING,
    "Trees": Cell.TREE,
    "Obstacles": Cell.OBSTACLE,
    "Charging pads": Cell.PAD,
}
LETTERS = (
    "D is the drone, P a parcel to deliver, x a delivered one, . road, B building, T tree, O obstacle, C charging pad."
)
MOVES = [("UP", "y", "-"), ("DOWN", "y", "+"), ("LEFT", "x", "-"), ("RIGHT", "x", "+")]
REWARDS = "delivery battery_dead wall blocked obstacle building tree wait step"


class NotToldError(Exception):
    """The text does not say what its reader has to know."""


class Told(NamedTuple):
    """What a prompt tells.

    Attributes:
        task: All numbers of the task that decide a flight; rewards and names are no part of a prompt, nor how maps are
            drawn.
        formula: The score at the end, of `delivered`, `battery`, `steps` and `all`.
        bounds: The least and the most that it can be.
        episode: One that stands so.
    """

    task: TaskConfig
    formula: str
    bounds: tuple[float, float]
    episode: Episode

    def score(self, delivered: int, battery: int, steps: int) -> float:
        """What a flight scores that ends so."""
        names = {"delivered": delivered, "battery": battery, "steps": steps}
        value = eval(self.formula, {}, {**names, "all": delivered == self.task.deliveries})
        return min(max(value, self.bounds[0]), self.bounds[1])


def said(text: str, pattern: str, what: str) -> tuple[str, ...]:
    """The groups of a pattern in a text.

    Raises:
        NotToldError: if it is not there.
    """
    found = re.search(pattern, text)
    if not found:
        raise NotToldError(what)
    return found.groups()


def read_text(messages: Sequence[ChatMessage]) -> Told:
    """What the messages of a prompt tell.

    Raises:
        NotToldError: at the first thing that they do not.
    """
    rules, seen = (message["content"] for message in messages)
    formula, lowest, highest = said(
        rules, r"Score at the end: (.*?)(?:, where .*)?; at least (\S+), at most (\S+)\.\n", "score"
    )
    deliveries, capacity, max_steps = (
        int(said(formula, rf"{name} / (\d+)", name)[0]) for name in ("delivered", "battery", "steps")
    )
    last = "; what the last step delivers still counts"
    ends = rf"The flight ends when everything is delivered, at 0 units of battery, or after {max_steps} steps{last}"
    said(rules, ends, "end")
    said(rules, "Coming to a parcel's cell delivers it; any order will do", "delivery")
    said(rules, "column x grows to the right from 0, row y grows downwards from 0", "axes")
    if re.findall(r"\b([A-Z]+) \(([xy]) ([+-]) 1\)", rules) != MOVES:
        raise NotToldError("actions")
    width, height = map(int, said(rules, r"The grid is (\d+) x (\d+):", "size"))
    ground = _ground(seen, width, height)
    x, y = map(int, said(seen, r"Position: \((\d+), (\d+)\)", "position"))
    ground[y, x] = KINDS[next(iter(re.findall("Below the drone: (.*)", seen)), "road")]
    counts = {f"{kind.name.lower()}s": int((ground == kind).sum()) for kind in TITLES.values() if kind != Cell.DELIVERY}
    task = TaskConfig(
        id="told",
        short_name="told",
        grader="none:none",
        width=width,
        height=height,
        deliveries=deliveries,
        max_steps=max_steps,
        battery_capacity=capacity,
        drain=_drain(rules),
        impassable=_impassable(rules),
        charge_rate=_charge_rate(rules, capacity),
        efficiency_needs_all=_needs_all(rules, formula),
        **counts,
        **{f"r_{name}": 0.0 for name in REWARDS.split()},
    )
    battery = int(said(seen, r"Battery: \d+% \((\d+) units\)", "battery")[0])
    steps = int(said(seen, rf"Step: (\d+) of {max_steps}\b", "steps")[0])
    wanted = np.flatnonzero(ground == Cell.DELIVERY).tolist()
    # Where one was delivered decides nothing more; it is no place of another.
    elsewhere = [cell for cell in range(width * height) if cell not in wanted][: deliveries - len(wanted)]
    parcels = [(cell, False) for cell in wanted] + [(cell, True) for cell in elsewhere]
    episode = standing_episode(task, ground, y * width + x, battery, steps, parcels)
    return Told(task, formula, (float(lowest), float(highest)), episode)


def _ground(seen: str, width: int, height: int) -> np.ndarray:
    ground = np.zeros((height, width), np.uint8)
    if LETTERS in seen:
        rows = [line.split() for line in seen.splitlines()[:height]]
        letters = {".": Cell.ROAD, "B": Cell.BUILDING, "T": Cell.TREE, "O": Cell.OBSTACLE, "P": Cell.DELIVERY}
        letters |= {"x": Cell.DELIVERED, "C": Cell.PAD, "D": Cell.ROAD}
        return np.array([[letters[letter] for letter in row] for row in rows], np.uint8)
    lists = dict(re.findall(r"^([A-Z][a-z ]+): ((?:\(\d+, \d+\) ?)+|none)$", seen, re.MULTILINE))
    if "Parcels to deliver" not in lists:
        # Of one parcel the target is all.
        lists["Parcels to deliver"] = said(seen, r"Target: (.*)", "parcels")[0]
    for title, kind in TITLES.items():
        for x, y in re.findall(r"\((\d+), (\d+)\)", lists.get(title, "")):
            ground[int(y), int(x)] = kind
    return ground


def _drain(rules: str) -> tuple[tuple[Cell, int], ...]:
    step = "Each step, waiting and bumping too, costs"
    if f"{step} 1 unit of battery, whatever lies below the drone." in rules:
        return ()
    beyond = "With too little left it is still flown, and leaves 0"
    (listed,) = said(rules, rf"{step} battery by the cell it ends on: (.*), any other 1 unit\. {beyond}", "drain")
    return tuple((KINDS[name], int(units)) for name, units in re.findall(r"([a-z ]+?) (\d+)(?:, |$)", listed))


def _impassable(rules: str) -> frozenset[Cell]:
    bumps = "off the grid(?:,)? the drone bumps: it stays where it is"
    said(rules, f"(?i){bumps}", "bumping")
    if "blocks no way" in rules:
        return frozenset()
    (listed,) = said(rules, rf"Cells that cannot be entered: (.*)\. Into one of them, or {bumps}", "what blocks")
    return frozenset(KINDS[name] for name in listed.split(", "))


def _charge_rate(rules: str, capacity: int) -> int:
    if "charging pad costs" not in rules:
        return 0
    rate, full = said(
        rules, r"WAIT on a charging pad costs nothing and adds (\d+) units, up to (\d+) in all", "charging"
    )
    assert int(full) == capacity
    return int(rate)


def _needs_all(rules: str, formula: str) -> bool:
    if "all" not in formula:
        return False
    said(rules, "where all is 1 if everything is delivered, else 0;", "all")
    return True
