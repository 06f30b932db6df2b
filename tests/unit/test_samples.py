"""Samples of the tour network: their values, and their states."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drone_env.agents.tour_features import LEFT, UNITS, FeatureEncoder, Features
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.planning.from_observation import episode_from_fields
from drone_env.planning.legs import LegSolver
from drone_env.planning.states import state_arrays
from drone_env.rl.samples import SampleGenerator, Samples
from tests.same import assert_same
from tests.unit.tour_features import EVERY_TASK

OWN = {
    "a long battery": replace(get_task("medium"), id="own", battery_capacity=140),
    "no pads": replace(get_task("skyline_easy"), id="own", pads=0, charge_rate=0, battery_capacity=120),
}
Option = tuple[int, int, int, int]
"""Target cell, units, steps, first action."""


def options_of(features: Features, m: int, stops: list[int]) -> list[Option]:
    """The options of state m, in order; token t leads to stop t - 1."""
    some = slice(features.begins[m], features.begins[m + 1])
    options = zip(features.token[some], features.numbers[some].tolist(), strict=True)
    return [(stops[token - 1], *numbers) for token, numbers in options]


def options_at(encoder: FeatureEncoder, episode: Episode) -> list[Option]:
    """The options that the agent has there."""
    ground, _, _ = state_arrays(episode)
    drone = np.array([[episode.cell, episode.battery_units, episode.task.max_steps - episode.steps]])
    # The agent knows the stops by their places alone.
    sites = [*np.flatnonzero(ground == Cell.DELIVERY).tolist(), *np.flatnonzero(ground == Cell.PAD).tolist()]
    return options_of(encoder.encode(ground[None], drone), 0, sites)


def states_of(task: TaskConfig, seed: int, samples: Samples) -> Iterator[tuple[Episode, list[Option], list[float]]]:
    """Each state as an episode, its options and their values.

    Features lack the cell of the drone: it is the one whose options are the same.
    """
    start, state, entries = state_arrays(Episode(task, seed=seed))
    parcels = state[entries].tolist()
    stops = [*parcels, *np.flatnonzero(start == Cell.PAD).tolist()]
    (features, values, _), encoder = samples, FeatureEncoder(task)
    for m in range(len(features.tokens)):
        options = options_of(features, m, stops)
        units = round(features.tokens[m, 0, UNITS] * task.battery_capacity)
        steps = task.max_steps - round(features.tokens[m, 0, LEFT] * task.max_steps)
        waiting = features.present[m, 1 : len(parcels) + 1].tolist()
        ground = start.copy()
        ground[parcels] = np.where(waiting, Cell.DELIVERY, Cell.DELIVERED)
        placed = [(cell, not waits) for cell, waits in zip(parcels, waiting, strict=True)]
        for cell in np.flatnonzero(~np.isin(ground, [Cell.DELIVERY, *task.impassable])).tolist():
            episode = episode_from_fields(task, ground, cell, units, steps, placed)
            if sorted(options_at(encoder, episode)) == sorted(options):
                yield episode, options, values[features.begins[m] : features.begins[m + 1]].tolist()
                break
        else:
            raise AssertionError(f"no cell has the options of state {m}")


def flown_along(encoder: FeatureEncoder, episode: Episode, option: Option) -> Episode:
    """The episode at the end of the path; each action comes from the rest of the option."""
    to, units, steps, action = option
    after = episode.copy()
    while True:
        before = after.battery_units
        after.step(action)
        units, steps = units - (before - after.battery_units), steps - 1
        if steps == 0:
            assert units == 0
            return after
        action = next(rest[3] for rest in options_at(encoder, after) if rest[:3] == (to, units, steps))


@pytest.mark.parametrize(
    "name",
    ["medium_delivery", "skyline_easy", "no pads", "a long battery"],
)
def test_an_option_is_worth_what_a_solver_says_of_where_it_leads(name: str) -> None:
    task = OWN.get(name) or EVERY_TASK[name]
    generator, encoder, compared = SampleGenerator(task, 1, 12), FeatureEncoder(task), 0
    for seed in (3, 4):
        for episode, options, values in states_of(task, seed, generator.generate(np.array([seed]))):
            solver = LegSolver(episode)
            for option, value in zip(options, values, strict=True):
                assert value == np.float32(solver.value(flown_along(encoder, episode, option)))
                compared += 1
    assert compared > 40


def test_lessons_depend_on_the_seeds_of_their_maps_alone() -> None:
    task, seeds = get_task("skyline_easy"), np.array([5, 6])
    generator = SampleGenerator(task, 2, 16)
    first = generator.generate(seeds)
    generator.generate(seeds + 2)
    again = generator.generate(seeds)
    assert_same(again, first)
    one = generator.generate(seeds[1:])
    assert len(first.features.tokens) == 2 * len(one.features.tokens) == 32
    assert np.array_equal(first.values[-len(one.values) :], one.values)


def test_of_every_state_that_is_kept_the_options_differ_in_worth() -> None:
    for name, fatal in (("hard", False), ("skyline_easy", True), ("rush_easy", True)):
        features, values, parcels = SampleGenerator(get_task(name), 8, 32).generate(np.arange(8))
        assert len(features.tokens) == 256
        first = features.begins[:-1]
        worst, best = (function.reduceat(values, first) for function in (np.minimum, np.maximum))
        assert (worst < best).all()
        # Where a parcel can be lost, a choice often decides on that.
        fewest, most = (function.reduceat(parcels, first) for function in (np.minimum, np.maximum))
        assert ((fewest < most).sum() > 64) == fatal
