"""Prompts state all that decides a flight: a planner that reads nothing but a prompt flies the optimum."""

import os
import re
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.rules import score_of
from drone_env.core.seeds import split_seeds
from drone_env.core.tables import interpreted
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.llm.answers import Answer, read_answer
from drone_env.llm.prompt import FOLDER, Prompt, get_prompt, prompt_ids, read_prompt
from drone_env.llm.text_episode import TextEpisode
from drone_env.planning.from_observation import episode_from_fields
from drone_env.planning.optimal import solve, solver_of
from drone_env.planning.stops import next_stops
from drone_env.server.openenv_session import full_text
from tests.tools import ROOT

MAPS = int(os.environ.get("DRONE_ENV_PROMPT_MAPS", "0"))
ALL = [*map(get_prompt, prompt_ids()), *map(read_prompt, sorted(FOLDER.glob("tools/*.toml")))]
PROMPTS = [prompt for prompt in ALL if prompt.id not in ("stops-1", "short-1")]
GENERATED = [task for task in TASKS.values() if task.terrain is None]
EASY, SKYLINE = TASKS["easy_delivery"], TASKS["skyline_easy"]
ODD = [
    replace(EASY, battery_capacity=25, width=9),
    replace(EASY, efficiency_needs_all=True, deliveries=2),
    replace(EASY, impassable=frozenset({Cell.TREE, Cell.BUILDING})),
    replace(EASY, drain=((Cell.ROAD, 2), (Cell.OBSTACLE, 0), (Cell.TREE, 1))),
    replace(EASY, pads=3, drain=((Cell.PAD, 4),)),
    replace(EASY, pads=3, charge_rate=7),
    replace(SKYLINE, drain=((Cell.DELIVERY, 3), (Cell.PAD, 2)), efficiency_needs_all=False),
]
"""Tasks with rules that no task of the package has."""
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
MOVES = [("UP", "y", "-"), ("DOWN", "y", "+"), ("LEFT", "x", "-"), ("RIGHT", "x", "+")]
TIER = {"easy": (), "skyline_easy": (), **dict.fromkeys(("hard", "skyline_hard", "rush_hard"), pytest.mark.long)}
TIERS = [pytest.param(t.short_name, marks=TIER.get(t.short_name, pytest.mark.campaign)) for t in GENERATED]
"""All generated tasks: the rules of each are read from every prompt anyway."""
REWARDS = "delivery battery_dead wall blocked obstacle building tree wait step"


class NotToldError(Exception):
    """The text does not say what its reader has to know."""


class Told(NamedTuple):
    """What a prompt tells: the task without rewards, the score as a formula with bounds and an episode."""

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
    """The groups of a pattern in a text; raises if it is not there."""
    found = re.search(pattern, text)
    if not found:
        raise NotToldError(what)
    return found.groups()


def read_text(rules: str, seen: str) -> Told:
    """What the system's and the user's text of a prompt tell.

    Raises:
        NotToldError: at the first thing that they do not.
    """
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
    return Told(task, formula, (float(lowest), float(highest)), episode)


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


def texts_of(prompt: Prompt, episode: Episode) -> tuple[str, str]:
    """The texts of the system and of the user."""
    system, user = prompt.messages(episode)
    return system["content"], user["content"]


def told_by(prompt: Prompt, episode: Episode) -> Told:
    """What a prompt tells of an episode."""
    return read_text(*texts_of(prompt, episode))


@pytest.mark.parametrize("task", [*GENERATED, *ODD], ids=lambda task: task.short_name)
@pytest.mark.parametrize("prompt", PROMPTS, ids=lambda prompt: prompt.id)
def test_the_score_of_a_task_is_read_from_the_prompt_alone(prompt: Prompt, task: TaskConfig) -> None:
    told = told_by(prompt, Episode(task, seed=3))
    for name in ("width", "height", "deliveries", "max_steps", "battery_capacity", "impassable", "charge_rate"):
        assert getattr(told.task, name) == getattr(task, name)
    assert dict(told.task.drain) == {kind: units for kind, units in task.drain if units != 1}
    for delivered in range(task.deliveries + 1):
        for battery, steps in ((0, task.max_steps), (1, 7), (task.battery_capacity // 2, 20)):
            score = score_of(interpreted(task), delivered, battery, steps)
            assert told.score(delivered, battery, steps) == pytest.approx(score, abs=1e-12)


def flown_by_reading(prompt: Prompt, task: str, seed: int) -> float:
    """The score of a planner that reads one prompt after another, or a single one that asks for the route."""
    episode = Episode(task, seed=seed)
    while not episode.ended:
        flight, says = told_by(prompt, episode).episode, []
        solver = solver_of(flight)
        while not flight.ended and (prompt.plan or not says):
            action = solver.optimal_actions(flight)[0]
            flight.step(action)
            says.append(action.name)
        for action in read_answer(Answer(text=" ".join(says)), prompt.plan, prompt.marks).actions:
            episode.step(action)
    return episode.score


@pytest.mark.parametrize("task", TIERS)
@pytest.mark.parametrize("prompt", PROMPTS, ids=lambda prompt: prompt.id)
def test_who_reads_nothing_but_the_prompt_flies_the_optimum(prompt: Prompt, task: str) -> None:
    for seed in split_seeds("test", MAPS or 1):
        assert flown_by_reading(prompt, task, seed) == solve(task, seed).score


STOP = re.compile(r"([A-Z]+) (parcel|pad)(?: cost(\d+))? steps(\d+) (spare|short)(\d+)(?: next(\d+))?")


@pytest.mark.parametrize("task", [*TASKS.values(), *ODD], ids=lambda task: task.short_name)
def test_each_stop_costs_what_the_prompt_says_and_no_pad_in_reach_is_left_out(task: TaskConfig) -> None:
    flight, rng = TextEpisode(task, 3, "stops"), np.random.default_rng(3)
    while flight.messages:
        before, lines = flight.episode, flight.messages[1]["content"].splitlines()
        assert lines[0] == f"{before.battery_units} units, {task.max_steps - before.steps} steps"
        options = [found.groups() for line in lines[1:] if (found := STOP.fullmatch(line))]
        assert len(options) == len(lines) - 1
        label, kind, cost, steps, sign, spare, _ = options[rng.integers(len(options))]
        units, start, done = before.battery_units, before.steps, before.deliveries_done
        flight.answer(f"**{label.lower()}**")
        after = flight.episode
        assert (flight.turns[-1], after.steps - start) == ("ok", int(steps))
        assert after.deliveries_done - done == (kind == "parcel")
        assert after.battery_units == (task.battery_capacity if kind == "pad" else max(0, units - int(cost)))
        if kind == "parcel" and not after.ended:
            ways = [option for option in next_stops(after) if not option.is_parcel]
            nearest = min((option.cost for option in ways), default=task.battery_capacity)
            # A pad that only a drone without units reaches is none.
            assert (sign == "spare") == (not task.charge_rate or not task.pads or nearest < after.battery_units)
            assert sign == "short" or task.uniform or after.battery_units - nearest - 1 <= int(spare)


@pytest.mark.parametrize("task", ["rush_easy", "skyline_easy"])
def test_the_prompt_of_the_examples_says_what_stops_says(task: str) -> None:
    flights = [TextEpisode(task, 3, get_prompt(name)) for name in ("stops", str(ROOT / "examples" / "rush.toml"))]
    while flights[0].messages:
        (system, listed), mine = ([message["content"] for message in flight.messages] for flight in flights)
        assert mine == [system, re.sub(r"^([A-Z]) (?:parcel )?(.*)$", r"\2=\1", listed, flags=re.MULTILINE)]
        for flight in flights:
            flight.answer(listed.splitlines()[1][0])
    assert flights[0].episode.actions == flights[1].episode.actions


def read_stops(text: str) -> str:
    """The answer of a rule that reads nothing but the prompt `stops`: a near parcel with units to spare, else a pad."""
    rows = [found.groups() for line in text.splitlines() if (found := STOP.fullmatch(line))]
    good = [row for row in rows if row[4] == "spare"] or [row for row in rows if row[1] == "pad"] or rows

    def key(row: tuple[str, ...]) -> tuple[bool, int]:
        return row[1] == "pad", int(row[3]) + int(row[6] or 0)

    return min(good, key=key)[0]


def test_a_rule_that_reads_nothing_but_the_stops_flies_well() -> None:
    shares = []
    for seed in split_seeds("validation", 20):
        flight = TextEpisode("skyline_easy", seed, "stops")
        while flight.messages:
            flight.answer(read_stops(flight.messages[1]["content"]))
        shares.append(flight.score / solve("skyline_easy", seed).score)
    assert np.mean(shares) > 0.9, shares


def test_openenv_shows_both_texts_of_a_prompt() -> None:
    prompt, episode = get_prompt("minimal"), Episode("hard", seed=3)
    assert full_text(prompt, episode) == "\n\n".join(texts_of(prompt, episode))
