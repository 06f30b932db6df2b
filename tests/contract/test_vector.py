"""The native vector environment against Gymnasium's own vectorisation of the single one."""

import os
import pickle
import warnings
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from drone_env.core.seeds import next_seed
from drone_env.core.tasks import TASKS
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.vector import DroneDeliveryVectorEnv
from drone_env.errors import EpisodeError, InvalidValueError, UnknownNameError

EASY = "drone_env:DroneDelivery-Easy-v1"
N = 6


def make(env_id: str = EASY, **options: Any) -> DroneDeliveryVectorEnv:
    env = gymnasium.make_vec(env_id, num_envs=N, **options)
    assert isinstance(env, DroneDeliveryVectorEnv)
    return env


def actions_of(step: int) -> np.ndarray:
    return (np.arange(N) * 3 + step * step // 3) % 5


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda mode: mode.value)
@pytest.mark.parametrize("task", [TASKS["easy_delivery"], TASKS["skyline_easy"]], ids=lambda task: task.id)
def test_it_does_what_gymnasiums_own_vectorisation_does(task: Any, mode: AutoresetMode) -> None:
    ours = make(f"drone_env:{task.gym_id}", autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: DroneDeliveryEnv(task)] * N, autoreset_mode=mode)
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] is mode
    observations, info = ours.reset(seed=11)
    expected, expected_info = theirs.reset(seed=11)
    assert info["seed"].tolist() == expected_info["seed"].tolist()
    ended = 0
    for step in range(3 * task.max_steps):
        for name in ("grid", "telemetry"):
            assert observations[name].dtype == expected[name].dtype
            assert np.array_equal(observations[name], expected[name])
        assert np.array_equal(info["action_mask"], np.stack(list(expected_info["action_mask"])))
        observations, *outcome, info = ours.step(actions_of(step))
        expected, *expected_outcome, expected_info = theirs.step(actions_of(step))
        for got, want in zip(outcome, expected_outcome, strict=True):
            assert got.dtype == want.dtype
            assert np.array_equal(got, want)
        assert ("final_info" in info) == outcome[1].any()
        ended += int(outcome[1].sum())
        if mode is AutoresetMode.SAME_STEP and "final_obs" in expected_info:
            assert info["_final_obs"].tolist() == expected_info["_final_obs"].tolist()
            assert info["_final_info"].tolist() == expected_info["_final_info"].tolist()
            for i in np.flatnonzero(info["_final_obs"]):
                for name in ("grid", "telemetry"):
                    assert np.array_equal(info["final_obs"][i][name], expected_info["final_obs"][i][name])
            for name in ("score", "seed"):
                assert np.array_equal(
                    info["final_info"][name][info["_final_info"]],
                    np.array(expected_info["final_info"][name])[info["_final_info"]],
                )
    assert ended > N


def test_final_info_tells_score_steps_deliveries_and_seed() -> None:
    env = make(autoreset_mode="SAME_STEP")
    env.reset(seed=[1, 2, 3, 4, 5, 6])
    for _ in range(60):
        *_, info = env.step(np.full(N, 4))
    final = info["final_info"]
    assert info["_final_info"].all()
    assert final["score"].tolist() == [0.01] * N
    assert final["steps"].tolist() == [60] * N
    assert final["deliveries"].tolist() == [0] * N
    assert final["seed"].tolist() == [1, 2, 3, 4, 5, 6]
    assert final["_score"].all()


@pytest.mark.parametrize("num_threads", [1, 2, 5, 64])
def test_threads_change_nothing(num_threads: int) -> None:
    env, single = make(num_threads=num_threads), make()
    env.reset(seed=0)
    single.reset(seed=0)
    for step in range(150):
        got, want = env.step(actions_of(step)), single.step(actions_of(step))
        assert np.array_equal(got[0]["grid"], want[0]["grid"])
        assert np.array_equal(got[1], want[1])
        if "final_info" in want[4]:
            assert np.array_equal(got[4]["final_info"]["score"], want[4]["final_info"]["score"])


def test_copies_stay_as_they_are_and_live_buffers_do_not() -> None:
    for copy in (True, False):
        env = make(copy=copy)
        observations, info = env.reset(seed=0)
        kept = (observations["grid"], observations["telemetry"], info["action_mask"])
        before = [array.copy() for array in kept]
        first = env.step(np.zeros(N, int))
        rewards = first[1].copy()
        for action in (1, 3, 4):
            env.step(np.full(N, action))
        assert np.array_equal(kept[0], before[0]) == copy
        assert np.array_equal(kept[1], before[1]) == copy
        if copy:
            assert np.array_equal(kept[2], before[2])
            assert np.array_equal(first[1], rewards)


def test_nobody_writes_to_what_a_step_hands_out_uncopied() -> None:
    env = make(copy=False)
    observations, info = env.reset(seed=0)
    stepped, *outcome, stepped_info = env.step(np.zeros(N, int))
    handed_out = [*observations.values(), *stepped.values(), *outcome, info["action_mask"], stepped_info["action_mask"]]
    for array in handed_out:
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0


def flight(env: DroneDeliveryVectorEnv, steps: int) -> list[np.ndarray]:
    """All that the steps bring, and the state that they lead to."""
    brought: list[np.ndarray] = []
    for step in range(steps):
        observations, *outcome, info = env.step(actions_of(step))
        finals = info.get("final_info", {})
        arrays = [*observations.values(), *outcome, info["action_mask"], *(finals[name] for name in sorted(finals))]
        brought += [array.copy() for array in arrays]
        for last in filter(None, info.get("final_obs", [])):
            brought += last.values()
    return brought + list(env.batch.get_state().values())


@pytest.mark.parametrize("copied", [deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("options", [{"autoreset_mode": "SAME_STEP"}, {"copy": False, "num_threads": 2}], ids=str)
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
    assert all(np.array_equal(array, kept[name]) for name, array in twin.batch.get_state().items())
    got = flight(twin, 70)
    assert len(got) == len(want) > 70 * 6  # some episodes ended
    assert all(map(np.array_equal, got, want))
    if not env.copy:
        with pytest.raises(ValueError, match="read-only"):
            twin.step(actions_of(0))[0]["grid"][:] = 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are never forked here")
def test_a_fork_after_threads_is_told_what_to_do_in_place_of_dying() -> None:
    threads, single = make(num_threads=2), make()
    for env in (threads, single):
        env.reset(seed=0)
        env.step(np.zeros(N, int))
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of newer Pythons, at a fork beside threads
        child = os.fork()
    if not child:
        try:
            single.step(np.ones(N, int))
            os.write(writing, f"{single.batch.rewards.sum()!r} ".encode())
            threads.step(np.ones(N, int))
        except EpisodeError as error:
            os.write(writing, str(error).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as told:
        rewards, _, message = told.read().partition(" ")
    assert os.waitpid(child, 0)[1] == 0
    assert rewards == repr(single.step(np.ones(N, int))[1].sum())
    assert "num_threads=2 does not work in a process forked" in message
    assert "'spawn'" in message
    threads.step(np.ones(N, int))


def test_reset_without_seeds_flies_each_episodes_next_map() -> None:
    env = make()
    _, first = env.reset()
    assert (first["seed"] >= 0).all()
    assert (first["seed"] < 2**52).all()
    assert env.reset()[1]["seed"].tolist() == [next_seed(seed) for seed in first["seed"].tolist()]
    _, mixed = env.reset(seed=[7, None, 9, None, None, 2**53 - 1])
    walked = [next_seed(next_seed(seed)) for seed in first["seed"].tolist()]
    assert mixed["seed"].tolist() == [7, walked[1], 9, walked[3], walked[4], 2**53 - 1]


def test_a_reset_mask_lets_the_others_fly_on() -> None:
    env = make()
    env.reset(seed=0)
    env.step(np.zeros(N, int))
    before = env.batch.grids.copy()
    mask = np.array([True, False, False, True, False, False])
    observations, info = env.reset(seed=100, options={"reset_mask": mask})
    assert info["seed"].tolist() == [100, 1, 2, 103, 4, 5]
    assert np.array_equal(observations["grid"][~mask], before[~mask])
    env.step(np.zeros(N, int))


@pytest.mark.parametrize("mask", [np.zeros(N, bool), np.ones(N + 1, bool), np.ones(N, int), [True] * (N - 1)], ids=str)
def test_a_mask_that_is_none_is_refused(mask: Any) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(InvalidValueError, match="reset_mask must be"):
        env.reset(options={"reset_mask": mask})


def test_the_first_reset_must_begin_all() -> None:
    mask = np.arange(N) < 2
    with pytest.raises(EpisodeError, match="must begin all"):
        make().reset(seed=0, options={"reset_mask": mask})
    with pytest.raises(EpisodeError, match="reset"):
        make().step(np.zeros(N, int))


@pytest.mark.parametrize(
    "seed", [-1, 2**53, 2**53 - 2, 7.0, True, "7", "123456", [0, 1], [0, 1, 2, 3, 4, -1], [0, 1, 2, 3, 4, 2.5]], ids=str
)
def test_a_seed_that_is_none_is_refused_and_nothing_is_changed(seed: Any) -> None:
    env = make()
    env.reset(seed=3)
    before = env.batch.seeds.copy()
    with pytest.raises(InvalidValueError, match="seed"):
        env.reset(seed=seed)
    assert np.array_equal(env.batch.seeds, before)


@pytest.mark.parametrize(
    "actions",
    [np.full(N, 5), np.array([0, 1, 2, 3, 4, -1]), np.array([0, 1, 2, 3, 4, 256]), np.zeros(N), np.zeros(N - 1, int)],
    ids=str,
)
def test_an_action_that_does_not_exist_is_refused_and_nothing_is_flown(actions: np.ndarray) -> None:
    env = make()
    env.reset(seed=3)
    before = env.batch.grids.copy()
    with pytest.raises(InvalidValueError, match="actions must be"):
        env.step(actions)
    assert np.array_equal(env.batch.grids, before)


def test_options_that_do_not_exist_are_refused_with_what_is_allowed() -> None:
    with pytest.raises(InvalidValueError, match="NEXT_STEP or SAME_STEP"):
        make(autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(InvalidValueError, match="render_mode"):
        make(render_mode="rgb_array")
    for wrong in (0, "4", 2.0, None, True):
        with pytest.raises(InvalidValueError, match="num_threads must be an integer of at least 1"):
            make(num_threads=wrong)
        with pytest.raises(InvalidValueError, match=f"num_envs must be an integer of at least 1, got {wrong!r}"):
            gymnasium.make_vec(EASY, num_envs=wrong)
    assert gymnasium.make_vec(EASY, num_envs=np.int64(N), task="easy").num_envs == N
    with pytest.raises(InvalidValueError, match="Easy-v1 does not fly task 'hard_delivery': make"):
        make(task="hard")
    with pytest.raises(UnknownNameError, match="aligned"):
        make(reward_profile="generous")
    env = make()
    with pytest.raises(InvalidValueError, match="allowed: reset_mask"):
        env.reset(options={"seed": 1})


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.int64, np.uint64])
def test_actions_of_any_integer_type(dtype: type) -> None:
    env, reference = make(), make()
    env.reset(seed=3)
    reference.reset(seed=3)
    for step in range(5):
        assert np.array_equal(
            env.step(actions_of(step).astype(dtype))[0]["grid"], reference.step(actions_of(step))[0]["grid"]
        )


def test_gymnasiums_vector_wrappers_work() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(make())
    env.reset(seed=0)
    lengths = []
    for _ in range(70):
        *_, info = env.step(np.full(N, 4))
        if "episode" in info:
            lengths += info["episode"]["l"][info["_episode"]].tolist()
    assert lengths == [60] * N
