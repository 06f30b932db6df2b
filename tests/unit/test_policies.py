"""Whatever can fly, by name and as an object: functions and classes of one's own, and how often they fly a map."""

import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from drone_env import evaluate, make_agent, summarise
from drone_env.cli import main
from drone_env.errors import AgentError, InvalidValueError, UnknownNameError
from drone_env.results.evaluate import episodes_key, repeats_of, run_episodes
from drone_env.results.result import repeated

MODULE = """
import random


def chase(observation):
    x, y, _, to_x, to_y = observation["telemetry"][:5]
    if abs(to_x - x) > abs(to_y - y):
        return 3 if to_x > x else 2
    return 1 if to_y > y else 0


class Chaser:
    def __init__(self, task):
        self.task = task

    def reset(self, seed):
        pass

    def act(self, observation):
        return chase(observation)


class Dice:
    stochastic = True

    def __init__(self, task):
        self.config = {"agent": "dice"}

    def reset(self, seed):
        self.random = random.Random(seed)

    def act(self, observation):
        return self.random.randrange(5)


class Homeless:
    pass


ready = Chaser(None)
class Faulty(Chaser):
    def act(self, observation):
        return [0, 1][self.step(observation)]

    def step(self, observation):
        return 2 if observation["telemetry"][2] < 0.99 else 0


class FaultyTogether(Faulty):
    def reset_batch(self, seeds):
        pass

    def act_batch(self, grids, telemetry):
        return [self.act({"telemetry": row}) for row in telemetry]


def seven(observation):
    return 7
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A module in the working directory."""
    (tmp_path / "my_policies.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield lambda: sys.modules["my_policies"]
    sys.modules.pop("my_policies", None)


@pytest.mark.parametrize("name", ["chase", "Chaser", "ready"])
def test_functions_classes_and_agents_of_a_module_fly_by_their_names(mine: Any, name: str) -> None:
    greedy = evaluate("greedy", "easy", seeds=range(20))  # which flies the same way where nothing blocks or costs
    by_name = run_episodes(episodes_key("easy", f"my_policies:{name}", range(20)))
    as_it_is = evaluate(getattr(mine(), name), "easy", seeds=range(20))
    for results in (by_name, as_it_is):
        assert results.scores.tolist() == greedy.scores.tolist()
        assert results.optimal_scores.tolist() == greedy.optimal_scores.tolist()
    assert as_it_is.key.config_hash == by_name.key.config_hash


def test_what_flies_is_known_by_what_its_module_holds(mine: Any, tmp_path: Path) -> None:
    names = ("my_policies:chase", "my_policies:Chaser")
    before = [episodes_key("easy", name, range(1)).config_hash for name in names]
    assert before[0] != before[1]
    (tmp_path / "my_policies.py").write_text(MODULE + "# changed\n")
    after = [episodes_key("easy", name, range(1)).config_hash for name in names]
    assert not {*before} & {*after}


def test_results_of_code_without_a_file_are_never_those_of_other_code(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = ModuleType("typed")
    typed.__file__ = "<stdin>"  # as `python -` has it
    monkeypatch.setitem(sys.modules, "typed", typed)

    def key(code: str) -> Any:
        exec(f"import functools\npolicy = {code}", vars(typed))
        return evaluate(vars(typed)["policy"], "easy", seeds=range(2)).key

    keys = [key(code) for code in ("lambda o: 4", "lambda o: 0", "functools.partial(lambda a, o: a, 4)")]
    assert keys[0].agent == "typed:<lambda>"
    assert len({one.config_hash for one in keys}) == 3


def test_of_who_draws_lots_each_flight_over_a_map_is_another_and_the_same_every_time(mine: Any) -> None:
    keys = repeats_of(episodes_key("easy", "my_policies:Dice", range(30)), 3)
    assert [key.repeat for key in keys] == [0, 1, 2]
    flown = [run_episodes(key) for key in keys]
    assert len({tuple(results.steps.tolist()) for results in flown}) == 3
    for key, results in zip(keys, flown, strict=True):
        assert run_episodes(key).steps.tolist() == results.steps.tolist()
    by_map = repeated(flown).by_map()
    assert by_map.scores.tolist() == np.mean([results.scores for results in flown], axis=0).tolist()
    assert {row.flights for row in by_map.rows()} == {3}
    assert summarise(*flown)["mean_score"] == pytest.approx(np.mean([results.scores for results in flown]))
    # The interval is over maps.
    assert summarise(*3 * flown[:1])["score_ci95"] == pytest.approx(summarise(flown[0])["score_ci95"], abs=1e-12)
    assert len(repeats_of(episodes_key("easy", "greedy", range(2)), 3)) == 1


def test_repeats_are_kept_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["evaluate", "--task", "easy", "--agents", "random", "greedy", "--seeds", "0:9", "--repeats", "2"]
    folder = tmp_path / "results"
    assert main([*command, "--out", str(folder)]) == 0
    assert "2 flights of each stochastic agent per map" in " ".join(capsys.readouterr().out.split())
    assert len(list((folder / "pieces").iterdir())) == 3
    assert main([*command[:-1], "1", "--out", str(folder)]) == 2
    assert "holds another evaluation: only one of the two has" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("my_policies:missing", "my_policies.py has no 'missing'"),
        ("nowhere_at_all:chase", "cannot import module 'nowhere_at_all': ModuleNotFoundError"),
        ("my_policies:Homeless", "agent 'Homeless' on 'easy_delivery', constructor: TypeError"),
        ("leaving_policies:fly", "cannot import module 'leaving_policies': SystemExit: 0"),
    ],
)
def test_names_of_nothing_that_flies_are_refused(mine: Any, name: str, told: str) -> None:
    Path("leaving_policies.py").write_text("raise SystemExit(0)")
    with pytest.raises((AgentError, InvalidValueError, UnknownNameError), match=told):
        make_agent(name, "easy")


def test_an_agent_that_fails_is_told_with_task_map_step_and_its_own_traceback(
    mine: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = (
        "drone-env: agent 'my_policies:Faulty' on 'easy_delivery', map 3, step 2: IndexError: list index out of range"
    )
    maps = ["--task", "easy", "--seeds", "3:5"]
    for command in (
        ["fly", "--seed", "3", "--agent", "my_policies:Faulty"],
        ["evaluate", *maps, "--out", "kept", "--agents", "greedy", "my_policies:Faulty"],
    ):
        assert main(command) == 2
        told = capsys.readouterr().err
        assert told.endswith(failed + "\n")
        first = next(line for line in told.splitlines() if line.startswith("  File "))
        assert str(tmp_path / "my_policies.py") in first
    with pytest.raises(AgentError, match=r"maps 3 to 4, step 2: IndexError") as raised:
        run_episodes(episodes_key("easy", "my_policies:FaultyTogether", range(3, 5)))
    assert isinstance(raised.value.__cause__, IndexError)
    assert (again := pickle.loads(pickle.dumps(raised.value))).trace == raised.value.trace
    assert "return [0, 1]" in again.trace
    with pytest.raises(InvalidValueError, match="map 0, step 1: action must be"):
        run_episodes(episodes_key("easy", "my_policies:seven", range(1)))
