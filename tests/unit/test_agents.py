"""Agents fly from what they observe, and nothing else."""

import numpy as np
import pytest

from drone_env.agents import NETWORK_AGENTS, make_agent
from drone_env.agents.base import begin
from drone_env.core.actions import Action
from drone_env.core.batch import Batch
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from tests.api.flying import flown

SIMPLE = ("random", "greedy", "nearest", "beam")
PAIRS = [
    *((name, get_task(task)) for name in SIMPLE for task in ("easy", "hard", "skyline_easy", "city_small")),
    *(("tournet", get_task(name)) for name in ("medium", "skyline_easy", "city_small")),
    ("pathqnet", get_task("easy")),
    ("ppo", get_task("hard")),
]
"""Agents that fly batches, with tasks that they can fly: of one and of several parcels, without pads and with them."""
CIRCLES = 6755399441055752
"""A map of skyline_medium on which tournet circled a pad before it had a memory."""


@pytest.mark.parametrize(("name", "task"), PAIRS, ids=lambda value: getattr(value, "id", value))
def test_together_the_agents_choose_as_they_do_alone(
    name: str, task: TaskConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which also means: an agent flies a map in the same way every time."""
    monkeypatch.setattr("drone_env.agents.pathqnet.MAPS_AT_ONCE", 4)  # networks evaluate this many maps per call
    monkeypatch.setattr("drone_env.agents.tour_features.STATES_AT_ONCE", 2)
    seeds = np.array([0, 2**53 - 1, CIRCLES, 2**52, *range(500, 516)], np.int64)[: 3 if name in NETWORK_AGENTS else 20]
    together, alone = make_agent(name, task), make_agent(name, task)
    batch = Batch(task, len(seeds))
    batch.reset(seeds)
    together.reset_batch(seeds)
    chosen = []
    for _ in range(task.max_steps):
        chosen.append(together.act_batch(batch.grids, batch.telemetry))
        batch.step(chosen[-1])
    for i, seed in enumerate(seeds.tolist()):
        episode = Episode(task, seed=seed)
        act = begin(alone, name, episode)
        for actions in chosen:
            if episode.ended:
                break
            assert act(episode.observation()) == actions[i]
            episode.step(actions[i])
        assert episode.ended


def test_the_tour_network_does_not_circle_a_pad() -> None:
    """Its choices by the observation alone are up, down and wait, again and again until the steps run out."""
    flight = flown("skyline_medium", "tournet", seed=CIRCLES)
    assert flight.deliveries_done == flight.task.deliveries


def test_the_random_agent_draws_all_actions_alike_and_differently_on_each_map() -> None:
    flights = [flown("hard", "random", seed=seed).actions for seed in range(60)]
    drawn = [action for actions in flights for action in actions]
    for action in Action:
        assert drawn.count(action) / len(drawn) == pytest.approx(0.2, abs=0.02)
    assert len({tuple(actions) for actions in flights}) == len(flights)


@pytest.mark.parametrize("name", ["greedy", "nearest", "tournet"])
def test_what_is_no_observation_of_the_task_is_refused(name: str) -> None:
    task = get_task("skyline_easy")
    agent, batch = make_agent(name, task), Batch(task, 3)
    batch.reset(np.arange(3))
    grids, telemetry = batch.grids.copy(), batch.telemetry.copy()
    beside = telemetry.copy()
    beside[1, 0] = 1.0
    for wrong in (
        (grids[:1], telemetry),
        (grids, telemetry[:, :5]),
        (grids[:, 1:], telemetry),
        (np.full_like(grids, 255), telemetry),
        (grids, beside),
    ):
        with pytest.raises(InvalidValueError, match=r"observation|kinds of cells"):
            agent.act_batch(*wrong)
    assert len(agent.act_batch(grids, telemetry)) == 3
