"""The one unit of evaluation and the figures made from it."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from drone_env.agents import AGENTS, make_agent
from drone_env.agents.pathqnet import shipped_network
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.evaluate import (
    EpisodeResults,
    concatenate,
    episodes_key,
    pieces_of,
    run_episodes,
    summarise,
)
from drone_env.results.folder import ResultsFolder


def test_results_are_the_same_whole_or_in_pieces() -> None:
    key = episodes_key("medium", "greedy", split_seeds("test", 23), "test")
    whole, pieces = run_episodes(key), list(map(run_episodes, pieces_of(key, 5)))
    assert [len(piece.seeds) for piece in pieces] == [5, 5, 5, 5, 3]
    together = concatenate(pieces)
    assert together.key == key
    for name in ("seeds", "scores", "steps", "deliveries", "success", "optimal_scores", "optimal_steps"):
        assert np.array_equal(getattr(whole, name), getattr(together, name))
        assert getattr(whole, name).dtype == getattr(together, name).dtype
    assert summarise(whole) == summarise(together)


def test_no_agent_beats_the_optimum_and_the_optimal_agent_reaches_it() -> None:
    for agent in ("random", "greedy", "optimal"):
        results = run_episodes(episodes_key("hard", agent, range(40)))
        assert (results.scores <= results.optimal_scores).all()
        if agent == "optimal":
            assert (results.scores == results.optimal_scores).all()
            assert (results.steps == results.optimal_steps).all()


@pytest.mark.parametrize("agent", ["greedy", "optimal"])
def test_results_are_the_callers_own(agent: str) -> None:
    key = episodes_key("medium", agent, range(7))
    names = [field.name for field in fields(EpisodeResults) if field.name != "key"]
    first = run_episodes(key)
    before = {name: getattr(first, name).copy() for name in names}
    for done, name in enumerate(names, start=1):
        getattr(first, name)[:] = 0
        for other in names[done:]:
            assert np.array_equal(getattr(first, other), before[other]), other
    second = run_episodes(key)
    for name in names:
        assert np.array_equal(getattr(second, name), before[name])


def test_figures_by_hand() -> None:
    results = EpisodeResults(
        key=episodes_key("easy", "greedy", range(3)),
        seeds=np.arange(3),
        scores=np.array([0.9, 0.8, 0.01]),
        steps=np.array([10, 20, 60], np.int32),
        deliveries=np.array([1, 1, 0], np.int32),
        success=np.array([True, True, False]),
        optimal_scores=np.array([0.95, 0.95, 0.95]),
        optimal_steps=np.array([8, 15, 15], np.int32),
    )
    figures = summarise(results)
    assert figures["mean_score"] == pytest.approx(0.57)
    # Three maps say so little that the interval is the range of scores, and ends where it does.
    assert figures["score_ci95"] == [0.01, 0.99]
    assert figures["success_rate"] == pytest.approx(2 / 3)
    assert figures["mean_steps"] == 30
    assert figures["mean_optimal_score"] == pytest.approx(0.95)
    assert figures["score_ratio"] == pytest.approx(0.6)
    assert figures["mean_regret"] == pytest.approx(0.38)
    assert figures["mean_excess_steps"] == 3.5
    assert f"{results}" == repr(results)
    assert repr(results).splitlines() == [
        "greedy on easy_delivery v1",
        "maps 0 to 2 (3, split custom)",
        "score 0.5700 [0.0100, 0.9900] (95 %), optimum 0.9500, success 66.7%, steps 30.0",
    ]


def test_no_delivered_map_means_no_excess_steps() -> None:
    figures = summarise(run_episodes(episodes_key("hard", "random", range(2))))
    assert figures["success_rate"] == 0
    assert figures["mean_excess_steps"] is None


def test_where_no_planner_knows_the_optimum_its_figures_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    vast = {"deliveries": 16, "max_steps": 400, "battery_capacity": 1}
    task = replace(TASKS["skyline_hard"], id="vast", short_name="vast", grader="drone_env.graders:vast", **vast)
    monkeypatch.setitem(TASKS, "vast", task)
    results = run_episodes(episodes_key("vast", "greedy", range(2)))
    assert np.isnan(results.optimal_scores).all()
    assert results.optimal_steps.tolist() == [-1, -1]
    assert results.scores.tolist() == [0.01, 0.01]
    figures = summarise(results)
    unknown = ("mean_optimal_score", "score_ratio", "mean_regret", "mean_excess_steps")
    assert [figures[name] for name in unknown] == [None] * 4
    assert figures["mean_score"] == 0.01


def test_a_single_episode_has_no_interval() -> None:
    figures = summarise(run_episodes(episodes_key("easy", "greedy", range(1))))
    assert figures["score_ci95"] is None


def test_a_key_from_another_configuration_is_refused() -> None:
    key = episodes_key("easy", "greedy", range(2))
    with pytest.raises(InvalidValueError, match="made under"):
        run_episodes(key._replace(config_hash="0" * 16))
    with pytest.raises(InvalidValueError):
        run_episodes(key._replace(agent="optimal"))
    with pytest.raises(UnknownNameError, match="version"):
        run_episodes(key._replace(version=99))


def test_a_key_is_of_a_registered_task_and_of_its_split() -> None:
    shorter = replace(TASKS["easy_delivery"], max_steps=50, battery_capacity=50)
    with pytest.raises(InvalidValueError, match="register it first"):
        episodes_key(shorter, "greedy", range(2))
    with pytest.raises(InvalidValueError, match="are not of the split 'train'"):
        episodes_key("easy", "greedy", range(2**52 - 1, 2**52 + 1), "train")
    with pytest.raises(UnknownNameError, match="custom"):
        episodes_key("easy", "greedy", range(2), "dev")
    with pytest.raises(InvalidValueError, match="holds no seeds"):
        run_episodes(episodes_key("easy", "greedy", range(2))._replace(seeds=(1, 1)))


def test_only_the_first_flight_over_each_map_counts() -> None:
    """Those who are done first fly on over other maps until the last one is."""
    results = run_episodes(episodes_key("easy", "greedy", range(30)))
    assert len(set(results.steps.tolist())) > 1
    agent = make_agent("greedy", "easy")
    for seed, score, steps in zip(range(30), results.scores, results.steps, strict=True):
        episode = Episode("easy")
        agent.reset(episode.reset(seed))
        while not episode.ended:
            episode.step(agent.act(episode.observation()))
        assert (score, steps) == (episode.score, episode.steps)


def test_a_key_names_a_network_by_what_its_file_holds(tmp_path: Path) -> None:
    easy, medium = shipped_network(get_task("easy")), shipped_network(get_task("medium"))
    copy = tmp_path / "mine.safetensors"
    copy.write_bytes(easy.read_bytes())
    shipped, same, other = (
        episodes_key("easy", agent, range(1)).config_hash
        for agent in ("pathqnet", f"pathqnet:{copy}", f"pathqnet:{medium}")
    )
    assert shipped == same != other


@pytest.mark.parametrize("config", [None, 7, {"network": object()}])
def test_an_agent_must_say_what_decides_how_it_flies(config: object, monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent:
        def __init__(self, task: TaskConfig) -> None:
            if config is not None:
                self.config = config

    monkeypatch.setitem(AGENTS, "silent", Silent)
    with pytest.raises(InvalidValueError, match="agent 'silent' must have `config`, a mapping of JSON values"):
        episodes_key("easy", "silent", range(1))


def test_keys_differ_where_task_or_agent_differ() -> None:
    hashes = {episodes_key(t, a, range(1)).config_hash for t in ("easy", "hard") for a in ("greedy", "random")}
    assert len(hashes) == 4


@pytest.mark.parametrize(("task", "digest"), [("easy", "065303a98147f6d9"), ("skyline_hard", "a83c6680798ea57d")])
def test_the_hash_of_a_configuration_stays(task: str, digest: str) -> None:
    assert episodes_key(task, "greedy", range(1)).config_hash == digest


@pytest.mark.parametrize("seeds", [range(0), range(0, 10, 2), range(-1, 3), range(2**53 - 1, 2**53 + 1)])
def test_seeds_outside_what_is_allowed_are_refused(seeds: range) -> None:
    with pytest.raises(InvalidValueError):
        episodes_key("easy", "greedy", seeds)


def test_only_neighbours_are_put_together() -> None:
    results = [run_episodes(episodes_key("easy", "greedy", range(a, a + 2))) for a in (0, 2, 6)]
    assert len(concatenate(results[:2]).seeds) == 4
    with pytest.raises(InvalidValueError, match="neighbours"):
        concatenate(results[1:])
    with pytest.raises(InvalidValueError, match="no results"):
        concatenate([])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": 2}, "format_version: Input should be 1"),
        ({"piece": 500}, "holds another evaluation: piece: 500 is now 1000"),
        ({"format": "drone_env/other"}, "format: Input should be"),
    ],
)
def test_a_folder_of_another_format_is_refused(change: dict[str, object], message: str, tmp_path: Path) -> None:
    keys = [episodes_key("easy", "greedy", range(2))]
    ResultsFolder(tmp_path, keys)
    ResultsFolder(tmp_path, keys)
    config = tmp_path / "evaluation.json"
    config.write_text(json.dumps(json.loads(config.read_text()) | change))
    with pytest.raises(InvalidValueError, match=message):
        ResultsFolder(tmp_path, keys)
