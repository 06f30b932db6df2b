"""What a prompt tells, read from what is sent alone: the task, how its flights are scored, where the drone stands."""

import base64
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.llm.content import DRAWN, ChatMessage
from drone_env.planning.from_observation import episode_from_fields

from .picture_reader import read_picture

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
LEGEND = r"^(\S) is the drone, (\S) a parcel to deliver, (\S) a delivered one, (.*)\.$"
LOOKS = {
    "An orange box is a parcel to deliver": "parcel to deliver",
    "a grey roof is a building": "building",
    "round green crowns are a tree": "tree",
    "a red and white barrier is an obstacle": "obstacle",
    "a beige roof is buildings": "building",
    "pale green with darker crowns is trees": "tree",
    "grey with red hatching is obstacles": "obstacle",
    "a blue square with a flash is a charging pad": "charging pad",
}
MOVES = [("UP", "y", "-"), ("DOWN", "y", "+"), ("LEFT", "x", "-"), ("RIGHT", "x", "+")]
REWARDS = "delivery battery_dead wall blocked obstacle building tree wait step"


class NotToldError(Exception):
    """The text does not say what its reader has to know."""


class Told(NamedTuple):
    """What a prompt tells: the task without rewards, the score as a formula with bounds, an episode, action words."""

    task: TaskConfig
    formula: str
    bounds: tuple[float, float]
    episode: Episode
    words: Mapping[Action, str]

    def score(self, delivered: int, battery: int, steps: int) -> float:
        """What a flight scores that ends so."""
        names = {"delivered": delivered, "battery": battery, "steps": steps}
        value = eval(self.formula, {}, {**names, "all": delivered == self.task.deliveries})
        return min(max(value, self.bounds[0]), self.bounds[1])


def said(text: str, pattern: str, what: str) -> tuple[str, ...]:
    """The groups of a pattern in a text; raises if it is not there."""
    found = re.search(pattern, text)
    if not found:
        raise NotToldError(what)
    return found.groups()


def read_text(messages: Sequence[ChatMessage], names: Mapping[str, str]) -> Told:
    """What the messages of a prompt tell, as they are sent; `names` has the plain name of each drawn one.

    Raises:
        NotToldError: at the first thing that they do not.
    """
    rules, seen, picture = _parts(messages)
    rules, seen, words = _in_plain_words(rules, seen, names)
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
    ground = _ground(seen, width, height) if picture is None else _shown(rules, picture, width, height)
    x, y = map(int, said(seen, r"Position: \((\d+), (\d+)\)", "position"))
    ground[y, x] = KINDS[next(iter(re.findall("Below the drone: (.*)", seen)), "road")]
    charging = rf"WAIT on a charging pad costs nothing and adds (\d+) units, up to {capacity} in all"
    charge = said(rules, charging, "charging") if "charging pad costs" in rules else ()
    if "all" in formula:
        said(rules, "where all is 1 if everything is delivered, else 0;", "all")
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
        charge_rate=int(charge[0]) if charge else 0,
        efficiency_needs_all="all" in formula,
        **counts,
        **{f"r_{name}": 0.0 for name in REWARDS.split()},
    )
    battery = int(said(seen, r"Battery: \d+% \((\d+) units\)", "battery")[0])
    steps = int(said(seen, rf"Step: (\d+) of {max_steps}\b", "steps")[0])
    wanted = np.flatnonzero(ground == Cell.DELIVERY).tolist()
    # Where one was delivered decides nothing more; it is no place of another.
    elsewhere = [cell for cell in range(width * height) if cell not in wanted][: deliveries - len(wanted)]
    parcels = [(cell, False) for cell in wanted] + [(cell, True) for cell in elsewhere]
    episode = episode_from_fields(task, ground, y * width + x, battery, steps, parcels)
    return Told(task, formula, (float(lowest), float(highest)), episode, words)


def _parts(messages: Sequence[ChatMessage]) -> tuple[str, str, bytes | None]:
    """The text of the system, that of the user, and the picture beside it."""
    system, user = (message["content"] for message in messages)
    if isinstance(user, str):
        return system, user, None
    picture, text = user
    return system, text["text"], base64.b64decode(picture["image_url"]["url"].removeprefix(DRAWN), validate=True)


def _in_plain_words(rules: str, seen: str, names: Mapping[str, str]) -> tuple[str, str, Mapping[Action, str]]:
    """Both texts in plain words, and the word for each action, which the rules tell."""
    if "are drawn for this map" not in rules:
        return rules, seen, {action: action.name for action in Action}
    ways = {"y - 1": Action.UP, "y + 1": Action.DOWN, "x - 1": Action.LEFT, "x + 1": Action.RIGHT}
    words = {ways[way]: word for word, way in re.findall(r"\b([A-Z]+) is ([xy] [+-] 1)\b", rules)}
    (words[Action.WAIT],) = said(rules, r"\b([A-Z]+) waits;", "waiting")
    plain = {word: action.name for action, word in words.items()}
    for name, kind in names.items():
        long = "charging pad" if kind == "pad" else kind
        plain |= {name: long, f"{name}s": f"{long}s", name.capitalize(): long.capitalize()}
        plain[f"{name}s".capitalize()] = f"{long}s".capitalize()
    texts = [re.sub("[A-Za-z]+", lambda found: plain.get(found[0], found[0]), text) for text in (rules, seen)]
    return texts[0], texts[1], words


def _shown(rules: str, picture: bytes, width: int, height: int) -> np.ndarray:
    """What a picture shows, whose figures the text explains."""
    ground = read_picture(picture, width, height)
    told = {KINDS[kind] for look, kind in LOOKS.items() if look in rules}
    if {Cell(kind) for kind in np.unique(ground).tolist()} - told - {Cell.ROAD, Cell.DELIVERED}:
        raise NotToldError("what a figure is")
    said(rules, "and every other cell is road", "road")
    said(rules, "a green tick is a delivered parcel", "delivered parcels")
    return ground


def _ground(seen: str, width: int, height: int) -> np.ndarray:
    ground = np.zeros((height, width), np.uint8)
    legend = re.search(LEGEND, seen, re.MULTILINE)
    if legend:
        rows = [line.split() for line in seen.splitlines()[:height]]
        drone, parcel, delivered, rest = legend.groups()
        letters = {drone: Cell.ROAD, parcel: Cell.DELIVERY, delivered: Cell.DELIVERED}
        letters |= {one[0]: KINDS[one[2:]] for one in rest.split(", ")}
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
