"""What holds on every flight, in the standard tasks and in random ones."""

import os
import random
from dataclasses import replace
from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.core.actions import N_ACTIONS, Action, Event, Outcome
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.models import observation_fields
from drone_env.planning.from_observation import episode_of
from tests.toy import TOY

thorough = settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "300")), deadline=None, derandomize=True)

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
UNIFORM_TASK = STANDARD.filter(lambda task: task.uniform) | NUMBERS.map(uniform_task)
PARCELS_ALONE = TASK.map(lambda task: replace(task, efficiency_needs_all=True))
"""An unfinished mission is worth its parcels and nothing else."""


def started(task: TaskConfig, seed: int, profile: str = "tiered") -> Episode:
    episode = Episode(task, profile)
    episode.reset(seed)
    return episode


def finish(episode: Episode, actions: list[int]) -> None:
    """Fly the actions, then WAIT until the end."""
    for action in actions:
        episode.step(action)
    while not episode.ended:
        episode.step(Action.WAIT)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_the_drone_stays_on_the_grid_and_off_impassable_cells(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = started(task, seed)
    for action in actions:
        before = episode.position
        episode.step(action)
        x, y = episode.position
        assert 0 <= x < task.width
        assert 0 <= y < task.height
        assert abs(x - before[0]) + abs(y - before[1]) <= 1
        assert episode.under not in task.impassable
        grid = episode.grid()
        assert grid[y, x] == Cell.DRONE
        assert np.count_nonzero(grid == Cell.DRONE) == 1


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_steps_count_up_by_one_and_the_battery_rises_only_by_waiting_on_a_pad(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = started(task, seed)
    for action in actions:
        ended, steps, battery = episode.ended, episode.steps, episode.battery_units
        episode.step(action)
        assert episode.steps == steps + (not ended)
        assert 0 <= episode.battery_units <= task.battery_capacity
        if episode.battery_units > battery:
            assert action == Action.WAIT
            assert episode.under == Cell.PAD
            assert episode.battery_units - battery <= task.charge_rate
        elif task.uniform:
            assert battery - episode.battery_units == (not ended)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_delivered_stays_delivered(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = started(task, seed)
    for action in actions:
        if episode.ended:
            break
        before = episode.parcels
        episode.step(action)
        for (*was_at, was_done), (*now_at, now_done) in zip(before, episode.parcels, strict=True):
            assert now_at == was_at
            assert now_done or not was_done
            assert now_done == (was_done or tuple(now_at) == episode.position)
        assert episode.deliveries_done == sum(done for *_, done in episode.parcels)
        assert (episode.event == Event.DELIVERY) == (episode.parcels != before)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_the_target_is_undelivered_and_changes_only_when_it_has_been_delivered(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = started(task, seed)
    for action in actions:
        before = episode.target
        episode.step(action)
        x, y = episode.position
        far = {(px, py): abs(px - x) + abs(py - y) for px, py, done in episode.parcels if not done}
        if before in far:
            assert episode.target == before
        elif far:
            assert episode.target == min(far, key=far.__getitem__)  # the first of the nearest
        else:
            assert episode.target is None
        assert episode.distance_to_target == (None if episode.target is None else far[episode.target])


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_the_score_is_the_formula_computed_exactly_and_rounded_once(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = started(task, seed)
    for action in actions:
        episode.step(action)
    delivered = Fraction(episode.deliveries_done, task.deliveries)
    battery = Fraction(episode.battery_units, task.battery_capacity)
    time = 1 - Fraction(episode.steps, task.max_steps)
    exact = Fraction("0.8") * delivered
    if delivered == 1 or not task.efficiency_needs_all:
        exact += Fraction("0.2") * (battery / 2 + time / 2)
    assert episode.score == float(min(max(exact, Fraction("0.01")), Fraction("0.99")))


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_an_episode_ends_for_exactly_one_reason(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = started(task, seed)
    finish(episode, actions)
    if episode.deliveries_done == task.deliveries:
        assert episode.outcome == Outcome.DELIVERED
    elif episode.battery_units == 0:
        assert episode.outcome == Outcome.BATTERY_DEAD
    else:
        assert (episode.outcome, episode.steps) == (Outcome.OUT_OF_STEPS, task.max_steps)
    assert episode.steps <= task.max_steps
    for step in episode.path[:-1]:
        assert step.battery > 0


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_aligned_shaping_adds_nothing_over_an_episode_but_the_potential_of_the_start(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    episode = started(task, seed, "aligned")
    assert episode.distance_to_target is not None
    start = 0.2 + 0.8 / task.deliveries * (1 - episode.distance_to_target / (task.width + task.height))
    finish(episode, actions)
    discounted = sum(0.99**i * step.reward for i, step in enumerate(episode.path))
    assert abs(discounted - (0.99 ** (episode.steps - 1) * episode.score - start)) < 1e-12


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_an_unfinished_episode_counts_exactly_what_waiting_to_the_end_would_score(
    task: TaskConfig, seed: int, actions: list[int]
) -> None:
    """So in every task, whoever stops could have had as much by going on: stopping is never better than the best."""
    episode = started(task, seed)
    for action in actions:
        episode.step(action)
    before = episode.get_state()
    counted = episode.counted_score()
    assert episode.get_state() == before
    finish(episode, [])
    assert episode.score == counted == episode.counted_score()


@thorough
@given(UNIFORM_TASK | PARCELS_ALONE, SEEDS, ACTIONS, ACTIONS)
def test_where_a_step_costs_one_unit_or_parcels_alone_count_stopping_never_beats_going_on_in_whatever_way(
    task: TaskConfig, seed: int, actions: list[int], further: list[int]
) -> None:
    """Not so elsewhere where cells drain differently: there a careless flight can burn what waiting would have kept."""
    episode = started(task, seed)
    for action in actions:
        episode.step(action)
    stopped = episode.counted_score()
    finish(episode, further)
    assert stopped <= episode.score


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_action_mask_agrees_with_what_a_step_does(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = started(task, seed)
    for action in actions:
        mask, before = episode.action_mask(), episode.position
        assert mask[Action.WAIT] == 1
        if episode.ended:
            break
        episode.step(action)
        if action != Action.WAIT:
            assert mask[action] == (episode.position != before)
        if mask[action]:
            assert episode.event not in (Event.WALL, Event.BLOCKED)
        else:
            assert episode.event in (Event.WALL, Event.BLOCKED, Event.BATTERY_DEAD)


@thorough
@given(TASK, SEEDS, ACTIONS)
def test_what_is_told_to_lie_below_the_drone_lies_there(task: TaskConfig, seed: int, actions: list[int]) -> None:
    episode = started(task, seed)
    city = episode.grid()
    city[episode.position[::-1]] = Cell.ROAD
    for action in actions:
        x, y = episode.position
        below = "delivered" if (x, y, True) in episode.parcels else Cell(city[y, x]).name.lower()
        assert observation_fields(episode)["cell_below"] == below
        told = episode.observation()["telemetry"][6:].tolist()
        order = ("road", "building", "tree", "obstacle", "delivery", "delivered", "pad") if task.pads else ()
        assert told == [float(name == below) for name in order]
        episode.step(action)
    assert episode_of(task, episode.observation()).under == episode.under


@thorough
@given(TASK, PROFILES, SEEDS, ACTIONS, ACTIONS)
def test_set_state_returns_to_the_snapshot(
    task: TaskConfig, profile: str, seed: int, actions: list[int], further: list[int]
) -> None:
    episode = started(task, seed, profile)
    for action in actions:
        episode.step(action)
    state, mask = episode.get_state(), episode.action_mask()
    rewards = [episode.step(action) for action in further]
    after = episode.get_state()
    episode.set_state(state)
    assert episode.get_state() == state
    assert np.array_equal(episode.action_mask(), mask)
    assert [episode.step(action) for action in further] == rewards
    assert episode.get_state() == after
