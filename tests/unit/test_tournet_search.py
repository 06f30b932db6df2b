"""The agent that tries whole plans of the tour network before it flies."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.agents.tour_encoder import FeatureEncoder
from drone_env.agents.tour_network import load_tour_network
from drone_env.agents.tour_plans import Choices, sample_options
from drone_env.agents.tournet import TournetAgent, TournetSearchAgent, best_options
from drone_env.core.actions import Action
from drone_env.core.batch import Batch
from drone_env.core.episode import Episode, rollout
from drone_env.core.tasks import TaskConfig
from tests.toy import toy_episode
from tests.unit.tour_features import EVERY_TASK, HARD, features_of

SEEDS = np.array([0, 2**53 - 1, 7, 2**52], np.int64)


def flown(agent: TournetSearchAgent, seed: int, told: int | None = None) -> Episode:
    """A flight over the map of a seed; the agent may be told another, by which it draws its plans."""
    agent.reset(seed if told is None else told)
    return rollout(Episode(agent.task, seed=seed), agent.act)


def whole_paths(task: TaskConfig, network: Path, seed: int) -> Episode:
    """A flight of the preferred paths, each flown to its end before the next choice."""
    episode, encoder, net = Episode(task, seed=seed), FeatureEncoder(task), load_tour_network(network)
    while not episode.ended:
        features = features_of(encoder, episode.observation())
        best = best_options(features, net(features)[0])[0]
        if best < 0:
            return episode.waited_out()
        units, steps, action = features.numbers[best].tolist()
        stop = int(features.token[best])
        while steps > 0:
            before = episode.battery_units
            episode.step(action)
            units, steps = units - before + episode.battery_units, steps - 1
            if steps:
                features = features_of(encoder, episode.observation())
                rest = zip(features.token.tolist(), features.numbers.tolist(), strict=True)
                action = next(first for token, (u, s, first) in rest if (token, u, s) == (stop, units, steps))
    return episode


@pytest.mark.parametrize("name", EVERY_TASK)
def test_the_only_plan_of_one_is_to_fly_the_preferred_ways(name: str, network: Path) -> None:
    agent = TournetSearchAgent(EVERY_TASK[name], network, plans=1)
    for seed in SEEDS[:2].tolist():
        assert flown(agent, seed).actions == whole_paths(agent.task, network, seed).actions


@pytest.mark.parametrize("name", EVERY_TASK)
def test_the_plan_is_the_best_of_those_that_were_tried(name: str, network: Path) -> None:
    """More plans are never worse: the first are the same."""
    task = EVERY_TASK[name]
    seeds = SEEDS[: 1 if task.deliveries == 16 else 4].tolist()
    few, some, many = (
        [flown(TournetSearchAgent(task, network, plans=plans), seed).score for seed in seeds] for plans in (1, 4, 32)
    )
    assert all(a <= b <= c for a, b, c in zip(few, some, many, strict=True))
    if not task.uniform:
        assert sum(many) > sum(few)


@pytest.mark.parametrize("name", EVERY_TASK)
def test_together_and_alone_it_flies_the_same_plans(name: str, network: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drone_env.agents.tour_plans.FLIGHTS", 10)  # two maps at a time, and then one
    task, seeds = EVERY_TASK[name], SEEDS[:3]
    agent = TournetSearchAgent(task, network, plans=5)
    batch = Batch(task, len(seeds))
    batch.reset(seeds)
    agent.reset_batch(seeds)
    together: list[npt.NDArray[np.int64]] = []
    for _ in range(task.max_steps):
        together.append(agent.act_batch(batch.grids, batch.telemetry))
        batch.step(together[-1])
    alone = [flown(TournetSearchAgent(task, network, plans=5), seed).actions for seed in seeds.tolist()]
    assert [np.stack(together)[: len(actions), i].tolist() for i, actions in enumerate(alone)] == alone
    if task is HARD:
        assert alone[2] != flown(TournetSearchAgent(task, network, plans=5), int(seeds[2]), told=1).actions


def test_it_goes_on_from_wherever_it_is_put(network: Path) -> None:
    agent, episode = TournetSearchAgent(HARD, network), Episode(HARD, seed=3)
    agent.reset(3)
    agent.act(episode.observation())
    episode.fly([Action.WAIT, Action.WAIT])
    planned = agent.act(episode.observation())
    fresh = TournetSearchAgent(HARD, network)
    fresh.reset(3)
    assert fresh.act(episode.observation()) == planned
    episode.step(planned)
    assert rollout(episode, agent.act).ended


@pytest.mark.parametrize("agent", [TournetAgent, TournetSearchAgent])
def test_where_nothing_is_within_reach_it_waits_to_the_end(agent: Any, network: Path) -> None:
    episode = toy_episode(["@..0", "...."], max_steps=9, battery_capacity=2)
    assert rollout(episode, agent(episode.task, network).act).actions == [Action.WAIT] * 2


def test_options_are_drawn_by_their_logits() -> None:
    logits = np.array([0, 0.7 * np.log(3), 5], np.float32)
    choices = Choices(np.array([0, 2, 2, 3]), None, logits, np.array([1, -1, 2]))
    keys = np.arange(40_000) * 7919
    for state, expected in ((0, [0.25, 0.75, 0]), (2, [0, 0, 1])):
        found = sample_options(choices, np.full(len(keys), state), keys, 0.7)
        assert np.bincount(found, minlength=3) / len(keys) == pytest.approx(expected, abs=0.01)
    assert sample_options(choices, np.ones(3, np.int64), keys[:3], 0.7).tolist() == [-1, -1, -1]
