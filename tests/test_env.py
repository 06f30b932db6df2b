"""The world in one sitting: maps, flight, battery, collisions, rewards and grading, through the public interface."""

import gymnasium
import numpy as np
import pytest

import drone_env
from drone_env import GRADERS, TASKS, Action, DroneState, Episode, Outcome, generate_city_map, make_agent, solve


@pytest.mark.parametrize("task", TASKS)
def test_a_mission_from_map_to_grade(task: str) -> None:
    episode, agent = Episode(task), make_agent("optimal", task)
    agent.reset(episode.reset(7))
    assert np.array_equal(np.where(episode.grid() == 6, 0, episode.grid()), generate_city_map(task, 7).grid)
    while not episode.ended:
        episode.step(agent.act(episode.observation()))
    assert episode.outcome is Outcome.DELIVERED
    assert GRADERS[task](DroneState.of(episode)) == episode.score == solve(task, 7).score


def test_the_battery_ends_a_flight_that_goes_nowhere() -> None:
    episode = Episode("easy")
    episode.reset(1)
    for left in range(59, -1, -1):
        episode.step(Action.WAIT)
        assert episode.battery_units == left
    assert episode.outcome is Outcome.BATTERY_DEAD
    assert episode.score == 0.01


def test_the_edge_of_the_city_stops_the_drone() -> None:
    episode = Episode("easy")
    episode.reset(1)
    for _ in range(12):
        episode.step(Action.UP)
    x, y = episode.position
    assert y == 0
    assert episode.step(Action.UP) == pytest.approx(0.10)
    assert episode.position == (x, 0)
    assert episode.event.name == "WALL"


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_gymnasium_knows_every_task_by_import_alone(task: drone_env.TaskConfig) -> None:
    env = gymnasium.make(task.gym_id)
    observation, info = env.reset(seed=7)
    assert env.observation_space.contains(observation)
    assert info["seed"] == 7
