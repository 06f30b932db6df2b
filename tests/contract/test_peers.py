"""The peers of benchmarks/peers.py: a run from its first second to its figures."""

import json
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from drone_env.agents import AGENTS
from drone_env.core.tasks import get_task
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
