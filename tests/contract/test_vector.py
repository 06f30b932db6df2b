"""The native vector environment, in the ways that Gymnasium's own vectorisation cannot be compared with."""

import pickle
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import pytest

from drone_env.core.seeds import next_seed
from drone_env.envs.vector import DroneDeliveryVectorEnv
from drone_env.errors import EpisodeError, InvalidValueError
from tests.same import assert_same

EASY = "drone_env:DroneDelivery-Easy-v1"
N = 6


def make(env_id: str = EASY, **options: Any) -> DroneDeliveryVectorEnv:
    env = gymnasium.make_vec(env_id, num_envs=N, **options)
    assert isinstance(env, DroneDeliveryVectorEnv)
    return env


def actions_of(step: int) -> np.ndarray:
    return (np.arange(N) * 3 + step * step // 3) % 5


def test_copies_stay_as_they_are_and_live_buffers_do_not() -> None:
    for copy in (True, False):
        env = make(copy=copy)
        observations, info = env.reset(seed=0)
        stepped, rewards, *_ = env.step(np.zeros(N, int))
        kept = (*observations.values(), *stepped.values(), info["action_mask"], info["seed"], rewards)
        before = [array.copy() for array in kept]
        for action in (1, 3, 4):
            env.step(np.full(N, action))
        env.reset(seed=50)
        assert [np.array_equal(*pair) for pair in zip(kept, before, strict=True)] == [copy] * len(kept)


def flight(env: DroneDeliveryVectorEnv, steps: int) -> tuple[Any, ...]:
    """The last step, and the state that it leads to."""
    for step in range(steps - 1):
        env.step(actions_of(step))
    observations, *outcome, _ = env.step(actions_of(steps))
    return deepcopy((observations, outcome, env.batch.get_state()))


@pytest.mark.parametrize(
    ("options", "copied"),
    [({"autoreset_mode": "SAME_STEP"}, deepcopy), ({"copy": False}, lambda env: pickle.loads(pickle.dumps(env)))],
)
def test_a_copy_flies_on_as_the_original_does_and_apart_from_it(options: dict[str, Any], copied: Any) -> None:
    env = make(**options)
    assert not copied(env).batch.started
    env.reset(seed=0)
    env.action_space.seed(0)
    flight(env, 20)
    twin = copied(env)
    assert twin.spec == env.spec
    assert np.array_equal(twin.action_space.sample(), env.action_space.sample())
    kept = twin.batch.get_state()
    want = flight(env, 70)
    assert_same(twin.batch.get_state(), kept)
    got = flight(twin, 70)
    assert_same(got, want)
    if not env.copy:
        observations, *outcome, info = twin.step(actions_of(0))
        for array in (*observations.values(), *outcome, info["action_mask"], info["seed"]):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0


def test_reset_without_seeds_flies_each_episodes_next_map() -> None:
    env = make()
    _, first = env.reset()
    assert (first["seed"] >= 0).all()
    assert (first["seed"] < 2**52).all()
    assert env.reset()[1]["seed"].tolist() == [next_seed(seed) for seed in first["seed"].tolist()]
    _, mixed = env.reset(seed=[7, None, 9, None, None, 2**53 - 1])
    walked = [next_seed(next_seed(seed)) for seed in first["seed"].tolist()]
    assert mixed["seed"].tolist() == [7, walked[1], 9, walked[3], walked[4], 2**53 - 1]


@pytest.mark.parametrize("copy", [True, False])
def test_where_nothing_begins_by_itself_an_ended_episode_waits_for_its_reset(copy: bool) -> None:
    env = make(autoreset_mode="DISABLED", copy=copy)
    env.reset(seed=0)
    late = np.arange(N) % 2 == 1
    for _ in range(30):
        env.step(np.full(N, 4))
    env.reset(seed=100, options={"reset_mask": late})
    for _ in range(30):
        _, _, terminated, _, info = env.step(np.full(N, 4))
    assert terminated.tolist() == (~late).tolist()
    assert info["final_info"]["seed"][terminated].tolist() == [0, 2, 4]
    before = env.batch.get_state()
    with pytest.raises(EpisodeError, match=r'3 episodes have ended .the first is 0. .*"reset_mask"'):
        env.step(np.full(N, 4))
    assert_same(env.batch.get_state(), before)
    _, info = env.reset(options={"reset_mask": terminated})
    assert info["_seed"].tolist() == (~late).tolist()
    assert not env.step(np.full(N, 4))[2].any()


NO_MASKS = np.zeros(N, bool), np.ones(N + 1, bool), np.ones(N, int)
NO_SEEDS: Any = -1, 2**53 - 2, 7.0, [0, 1], [0, 1, 2, 3, 4, 2.5]
NO_ACTIONS = np.full(N, 256), np.zeros(N), np.zeros(N - 1, int)


@pytest.mark.parametrize(
    ("method", "arguments", "message"),
    [
        *(("reset", {"options": {"reset_mask": mask}}, "reset_mask must be") for mask in NO_MASKS),
        *(("reset", {"seed": seed}, "seed") for seed in NO_SEEDS),
        *(("step", {"actions": actions}, "actions must be") for actions in NO_ACTIONS),
    ],
    ids=str,
)
def test_what_is_no_mask_seed_or_action_is_refused_and_nothing_is_changed(
    method: str, arguments: dict[str, Any], message: str
) -> None:
    env = make()
    env.reset(seed=3)
    before = env.batch.get_state()
    with pytest.raises(InvalidValueError, match=message):
        getattr(env, method)(**arguments)
    assert_same(env.batch.get_state(), before)


def test_the_first_reset_must_begin_all() -> None:
    mask = np.arange(N) < 2
    with pytest.raises(EpisodeError, match="must start all"):
        make().reset(seed=0, options={"reset_mask": mask})
    with pytest.raises(EpisodeError, match="reset"):
        make().step(np.zeros(N, int))


def test_options_that_do_not_exist_are_refused_with_what_is_allowed() -> None:
    with pytest.raises(InvalidValueError, match="one of NEXT_STEP, SAME_STEP, DISABLED; got 'LATER'"):
        make(autoreset_mode="LATER")
    for number in (0, 2.0):
        with pytest.raises(InvalidValueError, match=f"num_envs must be an integer of at least 1, got {number}"):
            gymnasium.make_vec(EASY, num_envs=number)
    with pytest.raises(InvalidValueError, match="allowed: reset_mask"):
        make().reset(options={"seed": 1})


def test_the_limit_of_a_task_is_the_only_one() -> None:
    assert make().spec.max_episode_steps == make(max_episode_steps=60).spec.max_episode_steps == 60
    with pytest.raises(InvalidValueError, match="must be at least 60, the steps of 'easy_delivery', got 5: register"):
        make(max_episode_steps=5)
