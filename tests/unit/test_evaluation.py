"""The one unit of evaluation and the figures made from it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drone_env.agents import AGENTS
from drone_env.agents.pathqnet import shipped_network
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.evaluate import episodes_key, evaluate, run_episodes, summarise
from drone_env.results.result import COLUMNS, Results, concatenate
from tests.same import assert_same


def test_results_are_the_same_whole_or_in_pieces() -> None:
    key = episodes_key("medium", "greedy", split_seeds("test", 23), "test")
    whole, chunks = run_episodes(key), list(map(run_episodes, key.chunks(5)))
    assert [len(chunk.seeds) for chunk in chunks] == [5, 5, 5, 5, 3]
    together = concatenate(chunks, key)
    for name in COLUMNS:
        assert_same(getattr(together, name), getattr(whole, name))


def test_figures_by_hand() -> None:
    results = Results(
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
    # Three maps say so little that the interval is the range of scores, and ends where it does.
    assert figures["score_ci95"] == [0.01, 0.99]
    scores = {"mean_score": 0.57, "mean_optimal_score": 0.95, "score_ratio": 0.6, "mean_regret": 0.38}
    expected = scores | {"success_rate": 2 / 3, "mean_steps": 30, "mean_excess_steps": 3.5}
    assert {name: figures[name] for name in expected} == pytest.approx(expected)


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
    figures = summarise(run_episodes(episodes_key("hard", "random", range(1))))
    assert (figures["success_rate"], figures["mean_excess_steps"], figures["score_ci95"]) == (0, None, None)


def test_a_key_is_of_this_configuration_of_a_registered_task_and_of_its_split() -> None:
    key = episodes_key("easy", "greedy", range(2))
    with pytest.raises(InvalidValueError, match="made under"):
        run_episodes(key._replace(config_hash="0" * 16))
    with pytest.raises(InvalidValueError, match="register it first"):
        episodes_key(replace(TASKS["easy_delivery"], max_steps=50, battery_capacity=50), "greedy", range(2))
    with pytest.raises(InvalidValueError, match="are not of the split 'train'"):
        episodes_key("easy", "greedy", range(2**52 - 1, 2**52 + 1), "train")
    with pytest.raises(UnknownNameError, match="custom"):
        episodes_key("easy", "greedy", range(2), "dev")
    seeds: Any
    for seeds in (range(0), range(0, 10, 2), range(-1, 3), range(2**53 - 1, 2**53 + 1), [1, 2]):
        with pytest.raises(InvalidValueError):
            evaluate("greedy", "easy", seeds=seeds)


def test_a_key_names_a_network_by_what_its_file_holds(tmp_path: Path) -> None:
    easy, medium = shipped_network(get_task("easy")), shipped_network(get_task("medium"))
    copy = tmp_path / "mine.safetensors"
    copy.write_bytes(easy.read_bytes())
    shipped, same, other = (
        episodes_key("easy", agent, range(1)).config_hash
        for agent in ("pathqnet", f"pathqnet:{copy}", f"pathqnet:{medium}")
    )
    assert shipped == same != other
    assert episodes_key("skyline_hard", "greedy", range(1)).config_hash == "a83c6680798ea57d"


@pytest.mark.parametrize("config", [None, {"network": object()}])
def test_an_agent_must_say_what_decides_how_it_flies(config: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(AGENTS, "silent", lambda task: SimpleNamespace(config=config))
    with pytest.raises(InvalidValueError, match="agent 'silent' must have `config`, a mapping of JSON values"):
        episodes_key("easy", "silent", range(1))
