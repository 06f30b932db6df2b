"""Many drones at once fly as Gymnasium vectorises single ones, in every mode and form of the observation."""

import os
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

from drone_env.core.actions import N_ACTIONS
from drone_env.core.tasks import TaskConfig
from drone_env.envs import wrappers
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.vector import DroneDeliveryVectorEnv
from drone_env.envs.wrappers import vector
from tests.property.test_episode import NUMBERS, PROFILES, SEEDS, TASK
from tests.same import assert_same

several = settings(max_examples=int(os.environ.get("DRONE_ENV_EXAMPLES", "150")) // 10, deadline=None, derandomize=True)
N = 3
FORMS: dict[str, tuple[Any, Any]] = {
    "plain": (lambda env: env, lambda env: env),
    "planes": (wrappers.OneHotPlanes, vector.OneHotPlanes),
    "flat": (wrappers.FlatObservation, vector.FlatObservation),
    "stops": (wrappers.StopObservation, vector.StopObservation),
}


def assert_seen(told: tuple[Any, dict[str, Any]], expected: tuple[Any, dict[str, Any]]) -> None:
    """The same observations, and in `info` the same values of the same drones."""
    (seen, info), (want, theirs) = told, expected
    assert_same(seen, want)
    for name in ("seed", "action_mask"):
        mask = theirs[f"_{name}"]
        assert_same(info[f"_{name}"], mask)
        assert_same(info[name][mask], theirs[name][mask])


@pytest.mark.parametrize(
    ("mode", "form"),
    [
        (AutoresetMode.NEXT_STEP, "planes"),
        (AutoresetMode.SAME_STEP, "plain"),
        (AutoresetMode.SAME_STEP, "stops"),
        (AutoresetMode.DISABLED, "flat"),
    ],
)
@several
@given(task=TASK, profile=PROFILES, seeds=st.lists(SEEDS, min_size=N, max_size=N), number=NUMBERS)
def test_many_fly_as_gymnasium_vectorises_one(
    mode: AutoresetMode, form: str, task: TaskConfig, profile: str, seeds: list[int], number: int
) -> None:
    one, many = FORMS[form]
    ours = many(DroneDeliveryVectorEnv(N, task, reward_profile=profile, autoreset_mode=mode))
    theirs = SyncVectorEnv([lambda: one(DroneDeliveryEnv(task, None, profile))] * N, autoreset_mode=mode)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] is mode
    draw = np.random.default_rng(number)
    actions, over = np.zeros(N, int), np.zeros(N, bool)
    assert_seen(ours.reset(seed=seeds), theirs.reset(seed=seeds))
    for _ in range(60):
        begun = draw.random(N) < 0.05
        if mode is AutoresetMode.DISABLED:
            begun |= over
        if begun.any():
            seed = None if draw.random() < 0.5 else int(draw.integers(2**52))
            # An option of its own for each, as Gymnasium takes the mask out of what it is given.
            reset, expected = (env.reset(seed=seed, options={"reset_mask": begun.copy()}) for env in (ours, theirs))
            assert_seen(reset, expected)
            over = over & ~begun
            continue
        # Straight legs, which end in many places.
        actions = np.where(draw.random(N) < 0.4, draw.integers(N_ACTIONS, size=N), actions)
        seen, *paid, info = ours.step(actions)
        expected_seen, *expected_paid, expected_info = theirs.step(actions)
        assert_seen((seen, info), (expected_seen, expected_info))
        for got, want in zip(paid, expected_paid, strict=True):
            assert_same(got, want)
        over = expected_paid[1]
        assert ("final_info" in info) == over.any()
        assert ("final_obs" in info) == ("final_obs" in expected_info)
        if over.any():
            last = expected_info["final_info"] if mode is AutoresetMode.SAME_STEP else expected_info
            for name in ("score", "seed"):
                assert_same(info["final_info"][f"_{name}"], over)
                assert_same(info["final_info"][name][over], last[name][over])
        if "final_obs" in info:
            assert_same(info["_final_obs"], over)
            for got, want in zip(info["final_obs"][over], expected_info["final_obs"][over], strict=True):
                assert_same(got, want)
