"""The planners against brute force, on small maps with every mechanic: equal to the last bit."""

import os
import random
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.agents.planned import OptimalAgent
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.planning import optimal
from drone_env.planning.legs import LegSolver, covers
from drone_env.planning.solver import ExactSolver, Solver
from tests.brute_force import BruteForce
from tests.property.test_episode import custom_task, uniform_task

thorough = settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "15")), deadline=None, derandomize=True)

NUMBERS = st.integers(0, 2**32)


def small_task(number: int) -> TaskConfig:
    """A task of every mechanic, or in one case of four of none, with few enough states to try them all."""
    draw = random.Random(str(number))  # independent of what the task draws
    task = (uniform_task if draw.random() < 0.25 else custom_task)(number)
    steps = draw.randint(1, 24 if task.width * task.height <= 9 else 12)
    return replace(
        task,
        max_steps=steps,
        battery_capacity=draw.choice((steps, draw.randint(1, 16), draw.randint(1, 16))),
        charge_rate=task.charge_rate * draw.choice((1, 1, 4)),
    )


def small_episode(number: int) -> Episode:
    return Episode(small_task(number), "score", number)


def solvers_of(episode: Episode) -> list[Solver]:
    """Each solver that covers the task."""
    return [solver(episode) for solver in (ExactSolver, *([LegSolver] if covers(episode.task) else []))]


def assert_equal_values(solver: Solver, reference: BruteForce, episode: Episode) -> None:
    expected = reference.q_values(episode)
    values = solver.q_values(episode)
    assert values.tolist() == expected.tolist()
    assert solver.value(episode) == expected.max()
    assert solver.optimal_actions(episode) == tuple(a for a in Action if expected[a] == expected.max())


@thorough
@given(NUMBERS)
def test_values_and_best_flights_equal_brute_force_along_random_flights_and_in_any_state(number: int) -> None:
    draw = random.Random(number)
    episode = small_episode(number)
    solvers, reference = solvers_of(episode), BruteForce(episode)
    assert optimal.solve(episode.task, number).score == reference.value
    while not episode.ended:
        for solver in solvers:
            assert_equal_values(solver, reference, episode)
        # The best actions deliver, after which the rest of the map looks different.
        episode.step(draw.choice((draw.randrange(5), int(reference.q_values(episode).argmax()))))
    assert [solver.value(episode) for solver in solvers] == [episode.score] * len(solvers)
    for _ in range(6):
        episode.set_state(reference.state(draw.randrange(reference.size)))
        before, best = episode.get_state(), reference.q_values(episode).max()
        for solver in solvers:
            assert_equal_values(solver, reference, episode)
        for solver in solvers_of(episode):
            assert episode.copy().fly(solver.best_actions()).counted_score() == best
        solution = optimal.solve_episode(episode)
        flight = episode.copy().fly(solution.actions)
        assert (flight.ended, flight.score, solution.score) == (True, best, best)
        assert flight.steps == episode.steps + len(solution.actions), "it ends with its last action"
        assert episode.get_state() == before


@thorough
@given(NUMBERS)
def test_the_optimal_agent_makes_the_best_of_where_it_is_put(number: int) -> None:
    """From observations alone, although now and then something else is flown than what it chose."""
    draw = random.Random(number)
    episode = small_episode(number)
    reference, agent = BruteForce(episode), OptimalAgent(episode.task)
    agent.reset(number)
    best = reference.value
    while not episode.ended:
        action = agent.act(episode.observation())
        if draw.random() < 0.2:
            action = draw.randrange(5)
            best = reference.q_values(episode)[action]
        assert reference.q_values(episode)[action] == best
        episode.step(action)
    assert episode.score == best
