"""The peers of benchmarks/peers.py: a run from its first second to its figures."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from drone_env.agents import AGENTS
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.rl.common import Validation
from tests.package.installed import ROOT


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import peers

    before = dict(AGENTS)
    yield peers
    AGENTS.clear()
    AGENTS.update(before)


def test_the_policy_that_was_best_in_validation_is_the_one_that_flies(
    peers: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "VALIDATIONS", 4)
    task, seen, shares = get_task("skyline_easy"), [], iter([0.1, 0.7, 0.3, 0.2, *[0.1] * 100])

    class Scripted:
        """Says that the second policy is the best, and keeps which each was."""

        def validate(self, act: Any) -> Validation:
            seen.append(act.__self__.config)
            return Validation(next(shares), 1.0, 0.0)

    recipe = peers.RECIPES["wide"] | {"n_steps": 1, "batch_size": 256}  # an update after every step
    peer, watch = peers.train(task, "MaskablePPO", recipe, 3, 1.0, Scripted())
    assert len(watch.curve) == len(seen) >= 3
    assert peer.config == seen[1]
    assert len({json.dumps(config) for config in seen}) == len(seen)


@pytest.mark.parametrize(("algorithm", "recipe"), [("PPO", "dense"), ("MaskablePPO", "wide")])
def test_a_finished_run_is_read_and_not_repeated(
    algorithm: str, recipe: str, peers: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peers, "VALIDATION_MAPS", 5)
    monkeypatch.setattr(peers, "VALIDATIONS", 4)
    monkeypatch.setattr("training_runs.MAPS", 7)
    task = get_task("skyline_easy")

    def run() -> dict[str, Any]:
        return peers.run(task, algorithm, recipe, 3, 0.5, False, tmp_path)

    result = run()
    assert result["curve"]["cpu_seconds"][-1] == result["cpu_seconds"] >= 0.5
    assert result["steps"] % 256 == 0
    assert result["best_validation"] == max(result["curve"]["share"])
    assert 0 < result["test"]["score_ratio"] < 1
    (file,) = tmp_path.iterdir()
    file.write_text(json.dumps(result | {"steps": 1}))
    assert run()["steps"] == 1
    monkeypatch.setitem(peers.RECIPES, recipe, {"num_envs": 8})
    with pytest.raises(InvalidValueError, match="was trained with other settings"):
        run()
    assert peers.row(result).count("|") == peers.HEADER.splitlines()[0].count("|")
