"""What holds on every flight, in the standard tasks and in random ones."""

import os
import pickle
import random
from dataclasses import replace
from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.core.actions import N_ACTIONS, Action, Event
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.models import observation_fields
from drone_env.planning.from_observation import episode_of
from tests.toy import TOY

thorough = settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "50")), deadline=None, derandomize=True)

STANDARD = st.sampled_from(sorted(TASKS)).map(TASKS.__getitem__)
PROFILES = st.sampled_from(sorted(REWARD_PROFILES))
SEEDS = st.integers(0, 2**53 - 1)
BLOCKING = (Cell.BUILDING, Cell.TREE, Cell.OBSTACLE)
DRAINED = (Cell.ROAD, *BLOCKING, Cell.DELIVERY, Cell.DELIVERED, Cell.PAD)


@st.composite
def flights(draw: st.DrawFn) -> list[int]:
    """Actions: straight legs of one to six, long enough to end most flights and to deliver in many."""
    # One draw of bytes is far cheaper than a list of integers, and without a drawn size most would be very short.
    size = draw(st.sampled_from((10, 30, 60)))
    legs = draw(st.binary(min_size=size, max_size=size))
    return [action for leg in legs for action in [leg % N_ACTIONS] * (1 + leg // N_ACTIONS % 6)]


ACTIONS = flights()


def uniform_task(number: int) -> TaskConfig:
    """A small task in which every step costs one unit; the battery may hold more or less than `max_steps`."""
    draw = random.Random(number)
    width, height = draw.randint(2, 6), draw.randint(2, 6)
    room = width * height - 1
    deliveries = draw.randint(1, min(4, room))
    terrain = draw.choices((*BLOCKING, Cell.PAD), k=draw.randint(0, room - deliveries))
    return replace(
        TOY,
        width=width,
        height=height,
        deliveries=deliveries,
        buildings=terrain.count(Cell.BUILDING),
        trees=terrain.count(Cell.TREE),
        obstacles=terrain.count(Cell.OBSTACLE),
        pads=terrain.count(Cell.PAD),
        max_steps=draw.randint(1, 80),
        battery_capacity=draw.randint(1, 80),
        efficiency_needs_all=draw.random() < 0.5,
    )


def custom_task(number: int) -> TaskConfig:
    """The same with drains, pads that charge, and kinds that block the way."""
    draw = random.Random(number)
    return replace(
        uniform_task(number),
        drain=tuple((kind, draw.choice((0, 1, 1, 2, 5))) for kind in DRAINED if draw.random() < 0.5),
        impassable=frozenset(kind for kind in BLOCKING if draw.random() < 0.3),
        charge_rate=draw.randint(0, 5),
    )


# One draw per task: drawn number by number, the tasks would take most of the time.
NUMBERS = st.integers(0, 2**32)
TASK = STANDARD | NUMBERS.map(custom_task)


def finish(episode: Episode, actions: list[int]) -> None:
    """Fly the actions, then WAIT until the end."""
    episode.fly(actions)
    while not episode.ended:
        episode.step(Action.WAIT)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_what_holds_at_every_step(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = Episode(task, "tiered", seed)
    city = episode.grid()
    city[episode.position[::-1]] = Cell.ROAD
    order = ("road", "building", "tree", "obstacle", "delivery", "delivered", "pad") if task.pads else ()
    for action in actions:
        mask, at, target, parcels = episode.action_mask(), episode.position, episode.target, episode.parcels
        steps, battery = episode.steps, episode.battery_units
        assert mask[Action.WAIT] == 1
        if episode.ended:
            break
        episode.step(action)

        # The drone moves by one cell where the mask allows it, and nowhere else.
        x, y = episode.position
        assert abs(x - at[0]) + abs(y - at[1]) == (action != Action.WAIT and mask[action])
        assert episode.under not in task.impassable
        assert (episode.grid() == Cell.DRONE).nonzero() == (y, x)
        bumps = (Event.WALL, Event.BLOCKED)
        assert mask[action] or episode.event in (*bumps, Event.BATTERY_DEAD)
        assert not mask[action] or episode.event not in bumps

        # A step costs battery, unless it charges.
        assert episode.steps == steps + 1
        assert 0 <= episode.battery_units <= task.battery_capacity
        if episode.battery_units > battery:
            assert (action, episode.under) == (Action.WAIT, Cell.PAD)
            assert episode.battery_units - battery <= task.charge_rate
        elif task.uniform:
            assert battery - episode.battery_units == 1

        # Parcels are delivered where the drone is; the target changes only when it has been delivered.
        assert episode.parcels == [(px, py, done or (px, py) == (x, y)) for px, py, done in parcels]
        assert episode.deliveries_done == sum(done for *_, done in episode.parcels)
        assert (episode.event == Event.DELIVERY) == (episode.parcels != parcels)
        distances = {(px, py): abs(px - x) + abs(py - y) for px, py, done in episode.parcels if not done}
        expected = target if target in distances else min(distances, key=distances.__getitem__, default=None)
        assert episode.target == expected
        assert episode.distance_to_target == (None if expected is None else distances[expected])

        # The kind of the cell below is known.
        below = "delivered" if (x, y, True) in episode.parcels else Cell(city[y, x]).name.lower()
        assert observation_fields(episode)["cell_below"] == below
        assert episode.observation()["telemetry"][6:].tolist() == [float(name == below) for name in order]
    rebuilt = episode_of(task, episode.observation())
    assert np.array_equal(rebuilt.grid(), episode.grid())
    for name in ("under", "position", "steps", "battery_units", "deliveries_done", "score"):
        assert getattr(rebuilt, name) == getattr(episode, name), name
    assert sorted(rebuilt.parcels) == sorted(episode.parcels)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_the_score_is_the_formula_computed_exactly_and_rounded_once(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = Episode(task, "tiered", seed).fly(actions)
    delivered = Fraction(episode.deliveries_done, task.deliveries)
    battery = Fraction(episode.battery_units, task.battery_capacity)
    time = 1 - Fraction(episode.steps, task.max_steps)
    exact = Fraction("0.8") * delivered
    if delivered == 1 or not task.efficiency_needs_all:
        exact += Fraction("0.2") * (battery / 2 + time / 2)
    assert episode.score == float(min(max(exact, Fraction("0.01")), Fraction("0.99")))


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_aligned_shaping_adds_nothing_over_an_episode_but_the_potential_of_the_start(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = Episode(task, "aligned", seed)
    assert episode.distance_to_target is not None
    start = 0.2 + 0.8 / task.deliveries * (1 - episode.distance_to_target / (task.width + task.height))
    finish(episode, actions)
    discounted = sum(0.99**i * step.reward for i, step in enumerate(episode.path))
    assert abs(discounted - (0.99 ** (episode.steps - 1) * episode.score - start)) < 1e-12


@thorough
@given(TASK, PROFILES, SEEDS, ACTIONS, ACTIONS)
def test_set_state_returns_to_the_snapshot(
    task: TaskConfig, profile: str, seed: int, actions: list[int], further: list[int]
) -> None:
    episode = Episode(task, profile, seed).fly(actions)
    state, mask, message = pickle.dumps(episode.get_state()), episode.action_mask(), episode.message
    rewards = [episode.step(action) for action in further]
    after = episode.get_state()
    episode.set_state(pickle.loads(state))
    assert (pickle.dumps(episode.get_state()), episode.message) == (state, message)
    assert np.array_equal(episode.action_mask(), mask)
    assert [episode.step(action) for action in further] == rewards
    assert episode.get_state() == after
