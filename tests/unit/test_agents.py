"""Agents fly from what they observe, and nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from drone_env.agents import AGENTS, make_agent, network_file
from drone_env.agents.network import Network
from drone_env.agents.pathqnet import CHUNK, PathQNetAgent, shipped_network
from drone_env.agents.tour_network import TourNetwork
from drone_env.agents.tournet import SHIPPED
from drone_env.core.actions import Action
from drone_env.core.batch import Batch
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import CheckpointError, InvalidValueError, UnknownNameError, UnsupportedTaskError
from drone_env.planning.optimal import solve
from tests.which_tasks import SMALL


def flies(name: str, task: TaskConfig) -> bool:
    """Whether an agent that needs a network has one that is shipped."""
    if name == "pathqnet":
        return shipped_network(task).is_file()
    return not name.startswith("tournet") or SHIPPED.is_file()


MANY = [("tournet-search-64", "skyline_hard"), ("tournet-search-64", "city_small")]
PAIRS = [
    (name, task) for name in AGENTS for task in SMALL.values() if flies(name, task) and (name, task.id) not in MANY
]
"""Agents with the tasks that they can fly; the search with more plans differs by their number alone."""
FEWER = {"pathqnet": 9, "tournet": 5, "tournet-search": 4, "tournet-search-64": 2}
"""How many maps those fly that take their time."""


def fly(agent_name: str, task: TaskConfig, seed: int) -> Episode:
    agent = make_agent(agent_name, task)
    agent.reset(seed)
    episode = Episode(task)
    episode.reset(seed)
    while not episode.ended:
        episode.step(agent.act(episode.observation()))
    return episode


@pytest.mark.parametrize(("name", "task"), PAIRS, ids=lambda value: getattr(value, "id", value))
def test_an_agent_flies_a_map_in_the_same_way_every_time(name: str, task: TaskConfig) -> None:
    agent = make_agent(name, task)
    flights = []
    for _ in range(2):
        agent.reset(3)
        episode = Episode(task)
        episode.reset(3)
        while not episode.ended:
            action = agent.act(episode.observation())
            assert action in list(Action)
            episode.step(action)
        flights.append(episode.actions)
    assert flights[0] == flights[1] == fly(name, task, 3).actions


def test_the_random_agent_draws_all_actions_alike_and_differently_on_each_map() -> None:
    flights = [fly("random", get_task("hard"), seed).actions for seed in range(60)]
    drawn = [action for actions in flights for action in actions]
    for action in Action:
        assert drawn.count(action) / len(drawn) == pytest.approx(0.2, abs=0.02)
    assert len({tuple(actions) for actions in flights}) == len(flights)


def test_greedy_flies_straight_to_the_current_target() -> None:
    agent = make_agent("greedy", "hard")
    episode = Episode("hard")
    episode.reset(11)
    while not episode.ended:
        far, done = episode.distance_to_target, episode.deliveries_done
        episode.step(agent.act(episode.observation()))
        assert episode.deliveries_done > done or episode.distance_to_target == far - 1


@pytest.mark.parametrize("task", SMALL.values(), ids=SMALL)
def test_the_optimal_agent_scores_the_optimum(task: TaskConfig) -> None:
    for seed in range(100 if task.uniform else 15):
        assert fly("optimal", task, seed).score == solve(task, seed).score


def test_the_optimal_agent_scores_the_optimum_where_not_everything_can_be_delivered() -> None:
    for budget in (5, 10, 20):
        task = replace(get_task("hard"), id=f"short_{budget}", max_steps=budget, battery_capacity=budget + 3)
        for seed in range(30):
            assert fly("optimal", task, seed).score == solve(task, seed).score


def test_the_optimal_agent_goes_on_from_wherever_it_is_put() -> None:
    episode = Episode("hard")
    episode.reset(5)
    agent = make_agent("optimal", "hard")
    agent.reset(5)
    for action in (0, 0, 0, 3, 3, 3):
        agent.act(episode.observation())
        episode.step(action)
    while not episode.ended:
        episode.step(agent.act(episode.observation()))
    assert episode.success


def test_an_unknown_agent_is_refused_with_the_names_that_exist() -> None:
    with pytest.raises(UnknownNameError, match=r"'greedier'.*greedy, optimal, pathqnet, random"):
        make_agent("greedier", "easy")


@pytest.mark.parametrize(("name", "task"), PAIRS, ids=lambda value: getattr(value, "id", value))
def test_together_the_agents_choose_as_they_do_alone(name: str, task: TaskConfig) -> None:
    seeds = np.array([0, 2**53 - 1, 1, 2**52, *range(500, 516)], np.int64)[: FEWER.get(name, 20)]
    together, alone = make_agent(name, task), make_agent(name, task)
    batch = Batch(task, len(seeds))
    batch.reset(seeds)
    together.reset_batch(seeds)
    chosen = []
    for _ in range(task.max_steps):
        chosen.append(together.act_batch(batch.grids, batch.telemetry))
        batch.step(chosen[-1])
    for i, seed in enumerate(seeds.tolist()):
        alone.reset(seed)
        episode = Episode(task)
        episode.reset(seed)
        for actions in chosen:
            if episode.ended:
                break
            action = alone.act(episode.observation())
            if name != "optimal":
                assert action == actions[i]
            episode.step(actions[i])
        assert episode.ended
        if name == "optimal":
            assert episode.score == solve(task, seed).score


def test_the_network_flies_more_maps_than_it_takes_at_a_time() -> None:
    batch = Batch("easy", CHUNK + 3)
    batch.reset(np.arange(CHUNK + 3))
    agent = PathQNetAgent(get_task("easy"))
    chosen = agent.act_batch(batch.grids, batch.telemetry)
    assert chosen.shape == (CHUNK + 3,)
    for i in (0, CHUNK - 1, CHUNK, CHUNK + 2):
        assert agent.act({"grid": batch.grids[i], "telemetry": batch.telemetry[i]}) == chosen[i]


def test_a_network_that_takes_other_telemetry_is_refused() -> None:
    with pytest.raises(CheckpointError, match="takes 5 values of telemetry, and 'skyline_easy' has 13"):
        PathQNetAgent(get_task("skyline_easy"), shipped_network(get_task("easy")))


def test_together_the_optimal_agents_deliver_what_can_be_delivered() -> None:
    for budget in (1, 5, 10, 20, 30):
        task = replace(get_task("hard"), id=f"short_{budget}", max_steps=budget, battery_capacity=budget + 3)
        seeds = np.arange(50)
        agent = make_agent("optimal", task)
        batch = Batch(task, len(seeds))
        batch.reset(seeds)
        agent.reset_batch(seeds)
        scores: dict[int, float] = {}
        for _ in range(budget):
            batch.step(agent.act_batch(batch.grids, batch.telemetry))
            finals = batch.finals()
            scores |= dict(zip(finals["seed"].tolist(), finals["score"].tolist(), strict=True))
        assert {seed: scores[seed] for seed in seeds.tolist()} == {s: solve(task, s).score for s in seeds.tolist()}


def test_an_agent_may_be_named_with_the_file_of_its_network() -> None:
    assert network_file("tournet-search:nets/a:b.npz") == ("tournet-search", Path("nets/a:b.npz"))
    assert [network_file(name) for name in ("tournet", "greedy:a.npz", "ace:a.npz")] == [None] * 3


def test_where_no_tour_network_is_shipped_the_message_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("drone_env.agents.tournet.SHIPPED", tmp_path / "gone.npz")
    for name in ("tournet", "tournet-search", "tournet-search-64"):
        with pytest.raises(UnsupportedTaskError, match=r"gone\.npz: name a file, as in tournet:FILE"):
            make_agent(name, "easy")


@pytest.mark.parametrize("name", ["greedy", "optimal", "tournet", "tournet-search"])
def test_what_is_no_observation_of_the_task_is_refused(name: str) -> None:
    task = get_task("skyline_easy")
    agent, batch = make_agent(name, task), Batch(task, 3)
    batch.reset(np.arange(3))
    grids, telemetry = batch.grids.copy(), batch.telemetry.copy()
    beside = telemetry.copy()
    beside[1, 0] = 1.0
    for wrong in (
        (grids, telemetry[:1]),
        (grids[:1], telemetry),
        (grids.reshape(3, 4, -1), telemetry),
        (grids, telemetry[:, :5]),
        (np.full_like(grids, 255), telemetry),
        (grids.astype(np.int64), telemetry),
        (grids, beside),
        (grids, np.full_like(telemetry, np.nan)),
    ):
        agent.reset_batch(np.arange(3))
        with pytest.raises(InvalidValueError, match=r"observation|kinds of cells|reset_batch was told"):
            agent.act_batch(*wrong)
    agent.reset_batch(np.arange(3))
    assert len(agent.act_batch(grids, telemetry)) == 3


@pytest.mark.parametrize("name", ["optimal", "tournet-search"])
def test_plans_are_made_for_as_many_maps_as_were_named(name: str) -> None:
    task = get_task("skyline_easy")
    agent, batch = make_agent(name, task), Batch(task, 3)
    batch.reset(np.arange(3))
    with pytest.raises(InvalidValueError, match="reset_batch was told of 1 maps, and these are 3"):
        agent.act_batch(batch.grids, batch.telemetry)


def threads_of_numpy() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.mark.parametrize(
    ("name", "task_name", "network", "part"),
    [("pathqnet", "hard", Network, "_encode"), ("tournet", "skyline_hard", TourNetwork, "_linear")],
)
def test_a_network_computes_in_one_thread_and_leaves_others_theirs(
    name: str, task_name: str, network: type, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent, episode, original = make_agent(name, get_task(task_name)), Episode(task_name), getattr(network, part)
    seen: list[set[int]] = []

    def watched(*arguments: object) -> object:
        seen.append(threads_of_numpy())
        return original(*arguments)

    monkeypatch.setattr(network, part, watched)
    with threadpool_limits(2, user_api="blas"):
        agent.reset(0)
        episode.reset(0)
        agent.act(episode.observation())
        assert threads_of_numpy() == {2}
    assert seen
    assert all(threads == {1} for threads in seen)
