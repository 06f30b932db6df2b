"""What Gymnasium and its users expect, over every registered environment."""

import pickle
import warnings
from copy import deepcopy
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from drone_env.core.tasks import TASKS
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.wrappers import FlatObservation, OneHotPlanes, StopObservation
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.planning.optimal import solve

IDS = [f"drone_env:{task.gym_id}" for task in TASKS.values()]


def make(env_id: str = IDS[0], **options: Any) -> gymnasium.Env:
    return gymnasium.make(env_id, **options)


def fly_optimally(env: gymnasium.Env, task: str, seed: int, **reset: Any) -> tuple[float, dict]:
    env.reset(seed=seed, **reset)
    total = 0.0
    for action in solve(task, seed).actions:
        _, reward, terminated, truncated, info = env.step(action)
        assert not truncated
        total += float(reward)
    assert terminated
    return total, info


STANDARD, SKYLINE = IDS[0], IDS[3]
"""One of each kind: tasks differ in their numbers alone, and Skyline's telemetry has more values."""


@pytest.mark.parametrize(("env_id", "render_mode"), [(STANDARD, "ansi"), (STANDARD, "rgb_array"), (SKYLINE, None)])
def test_gymnasium_check_env_passes_without_a_warning(env_id: str, render_mode: str | None) -> None:
    check_env(make(env_id, render_mode=render_mode).unwrapped)


@pytest.mark.parametrize("wrapper", [OneHotPlanes, FlatObservation])
def test_gymnasium_check_env_passes_on_wrapped_environments(wrapper: type[gymnasium.Wrapper]) -> None:
    with warnings.catch_warnings():
        # The checker warns about every wrapped environment.
        warnings.filterwarnings("ignore", message=".*is different from the unwrapped version.*")
        check_env(wrapper(make(SKYLINE)))


@pytest.mark.parametrize(("env_id", "task"), list(zip(IDS, TASKS.values(), strict=True)), ids=TASKS)
def test_spaces_are_the_promised_ones(env_id: str, task: Any) -> None:
    env = make(env_id)
    assert env.action_space == gymnasium.spaces.Discrete(5)
    assert set(env.observation_space.spaces) == {"grid", "telemetry"}
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert (observation["grid"].shape, observation["grid"].dtype) == ((task.height, task.width), np.uint8)
    size = 5 if task.family == "standard" else 13
    assert (observation["telemetry"].shape, observation["telemetry"].dtype) == ((size,), np.float32)
    assert env.spec.max_episode_steps == gymnasium.spec(task.gym_id).max_episode_steps == task.max_steps


def test_info_has_the_same_keys_and_types_in_every_step() -> None:
    env, optimum = make(IDS[2]), solve("hard", 3)
    infos = [env.reset(seed=3)[1], *(env.step(action)[4] for action in optimum.actions)]
    types = {"seed": int, "score": float, "action_mask": np.ndarray, "event": str, "outcome": str}
    types |= {"optimal_score": float, "optimal_steps": int, "regret": float}
    for info in infos:
        assert {name: type(value) for name, value in info.items()} == types
        assert (info["action_mask"].dtype, info["action_mask"].shape) == (np.int8, (5,))
        assert (info["seed"], info["optimal_score"], info["optimal_steps"]) == (3, optimum.score, optimum.steps)
        assert info["regret"] == optimum.score - info["score"]
    assert {info["outcome"] for info in infos[:-1]} == {"flying"}
    assert [infos[-1][name] for name in ("outcome", "event", "regret")] == ["delivered", "delivery", 0]
    _, info = env.reset(seed=4)
    assert info["optimal_score"] == solve("hard", 4).score


def test_the_limit_that_libraries_read_truncates_nothing() -> None:
    task = replace(TASKS["skyline_easy"], battery_capacity=60, drain=())  # the steps run out, not the battery
    env = make(SKYLINE, task=task)
    for same in (env, pickle.loads(pickle.dumps(env)), deepcopy(env), gymnasium.make(deepcopy(env.spec))):
        same.reset(seed=1)
        ends = [same.step(4)[2:4] for _ in range(same.spec.max_episode_steps)]
        assert ends == [(False, False)] * (task.max_steps - 1) + [(True, False)]


def test_a_search_restores_states_and_its_steps_truncate_nothing() -> None:
    env, best = make(SKYLINE), solve("skyline_easy", 3)
    env.reset(seed=3)
    *_, first = env.step(best.actions[0])
    root = pickle.loads(pickle.dumps(env.unwrapped.get_state()))
    for _ in range(env.spec.max_episode_steps):
        *_, terminated, truncated, _ = env.step(4)
        if terminated:
            env.unwrapped.set_state(root)
    assert not truncated
    env.reset(seed=4)
    env.unwrapped.set_state(root)
    assert env.unwrapped.get_state() == root
    info = [env.step(action)[4] for action in best.actions[1:]][-1]
    assert (info["seed"], info["score"], info["regret"]) == (first["seed"], best.score, 0)


def test_what_a_specification_says_is_made_again() -> None:
    env = FlatObservation(make(IDS[2], reward_profile="score"))
    twin = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert twin.spec == env.spec
    assert str(twin) == str(env)
    assert fly_optimally(twin, "hard", 3)[1]["regret"] == 0
    assert twin.unwrapped.episode.reward_profile.id == "score"


@pytest.mark.parametrize("reset", [{"seed": 2**53}, {"options": {"reward_profile": "tiered"}}], ids=str)
def test_a_refused_reset_leaves_the_episode_as_it_was(reset: dict) -> None:
    env = make()
    env.reset(seed=1)
    env.step(0)
    before = env.unwrapped.episode.get_state()
    with pytest.raises(InvalidValueError):
        env.reset(**reset)
    assert env.unwrapped.episode.get_state() == before


def test_steps_outside_an_episode_need_a_reset() -> None:
    env = DroneDeliveryEnv()
    with pytest.raises(ResetNeeded):
        env.step(0)
    fly_optimally(env, "easy", 1)
    with pytest.raises(ResetNeeded):
        env.step(0)
    env.reset()
    env.step(0)
    with pytest.raises(ResetNeeded, match="call reset"):
        DroneDeliveryEnv(render_mode="ansi").render()


def test_unknown_options_of_make_are_refused_with_what_is_allowed() -> None:
    with pytest.raises(InvalidValueError, match=r"ansi, rgb_array$"):
        DroneDeliveryEnv(render_mode="png")


def test_the_flat_observation_holds_planes_and_telemetry() -> None:
    env, plain = FlatObservation(make()), make()
    flat, _ = env.reset(seed=2)
    observation, _ = plain.reset(seed=2)
    planes, _ = OneHotPlanes(make()).reset(seed=2)
    assert np.array_equal(flat[:900].reshape(9, 10, 10), planes["grid"])
    assert flat.shape == (9 * 100 + 5,)
    assert np.array_equal(flat[:900].reshape(9, 10, 10).argmax(axis=0), observation["grid"])
    assert np.array_equal(flat[900:], observation["telemetry"])


MIXTURE = "drone_env:DroneDelivery-Mixture-v1"
MIXED = ["easy", "skyline_easy", "rush_easy"]


@pytest.mark.parametrize(("stops", "numbers"), [(False, "telemetry"), (True, "features")])
def test_a_mixture_pads_the_observations_of_its_tasks(stops: bool, numbers: str) -> None:
    env = make(MIXTURE, tasks=MIXED, stops=stops)
    check_env(env.unwrapped)
    for number, task in enumerate(MIXED):
        observation, info = env.reset(seed=7, options={"task": task})
        plain = DroneDeliveryEnv(task)
        given = (StopObservation(plain) if stops else plain).reset(seed=7)[0]
        assert info["task"] == env.step(4)[4]["task"] == plain.task.id
        assert env.observation_space.contains(observation)
        for name, values in given.items():
            expected = np.full(env.observation_space[name].shape, 9 if name == "grid" else 0, values.dtype)
            expected[tuple(map(slice, values.shape))] = values
            if name == numbers:
                expected[number - len(MIXED)] = 1
            assert np.array_equal(observation[name], expected)


def test_a_mixture_draws_tasks_and_maps_from_its_seed() -> None:
    env, again = make(MIXTURE, tasks=MIXED), FlatObservation(make(MIXTURE, tasks=MIXED))
    drawn = [
        [(info["task"], info["seed"]) for info in (one.reset(seed=seed)[1] for seed in (5, *[None] * 20))]
        for one in (env, again)
    ]
    assert drawn[0] == drawn[1]
    assert drawn[0][0][1] == 5
    assert (len({task for task, _ in drawn[0]}), len({seed for _, seed in drawn[0]})) == (3, 21)
    with pytest.raises(UnknownNameError, match="rush_easy"):
        env.reset(options={"task": "hard"})
    with pytest.raises(InvalidValueError, match="no options"):
        env.reset(options={"map": 1})
    with pytest.raises(InvalidValueError, match="at least one task"):
        make(MIXTURE, tasks=[])
