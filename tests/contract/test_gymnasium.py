"""What Gymnasium and its users expect, over every registered environment."""

import warnings
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from drone_env.core.tasks import TASKS
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.rendering import draw_picture
from drone_env.envs.wrappers import FlatObservation, OneHotPlanes, WithOptimum
from drone_env.errors import InvalidValueError
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


@pytest.mark.parametrize(
    ("env_id", "render_mode"), [(STANDARD, None), (STANDARD, "ansi"), (STANDARD, "rgb_array"), (SKYLINE, None)]
)
def test_gymnasium_check_env_passes_without_a_warning(env_id: str, render_mode: str | None) -> None:
    check_env(make(env_id, render_mode=render_mode).unwrapped)


def test_gymnasium_shows_it_in_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # no real screen
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    import pygame

    with pytest.warns(UserWarning, match="HumanRendering wrapper is being applied"):
        env = make(render_mode="human")
    env.reset(seed=7)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert np.array_equal(shown, draw_picture(env.unwrapped.episode))
    env.close()


@pytest.mark.parametrize("wrapper", [OneHotPlanes, FlatObservation])
def test_gymnasium_check_env_passes_on_wrapped_environments(wrapper: type[gymnasium.Wrapper]) -> None:
    with warnings.catch_warnings():
        # The checker says so of every wrapped environment.
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


def test_info_tells_score_event_and_mask_and_at_the_end_optimum_and_regret() -> None:
    env = make(IDS[2])
    _, info = env.reset(seed=3)
    assert set(info) == {"seed", "score", "action_mask", "event"}
    assert info["action_mask"].dtype == np.int8
    _, info = fly_optimally(env, "hard", 3)
    optimum = solve("hard", 3)
    assert (info["outcome"], info["event"], info["seed"]) == ("delivered", "delivery", 3)
    assert info["score"] == info["optimal_score"] == optimum.score
    assert info["optimal_steps"] == optimum.steps
    assert info["regret"] == 0


def test_where_no_planner_knows_the_optimum_it_is_none() -> None:
    task = replace(TASKS["skyline_hard"], id="vast", deliveries=16, max_steps=400, battery_capacity=1)
    env = WithOptimum(DroneDeliveryEnv(task))
    env.reset(seed=3)
    *_, info = env.step(4)
    assert (info["outcome"], info["score"]) == ("battery_dead", 0.01)
    assert [info[name] for name in ("optimal_score", "optimal_steps", "regret")] == [None] * 3


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
    with pytest.raises(InvalidValueError, match="Easy-v1 does not fly task 'hard_delivery': make"):
        gymnasium.make("drone_env:DroneDelivery-Easy-v1", task="hard")


def test_the_flat_observation_holds_planes_and_telemetry() -> None:
    env, plain = FlatObservation(make()), make()
    flat, _ = env.reset(seed=2)
    observation, _ = plain.reset(seed=2)
    planes, _ = OneHotPlanes(make()).reset(seed=2)
    assert np.array_equal(flat[:900].reshape(9, 10, 10), planes["grid"])
    assert flat.shape == (9 * 100 + 5,)
    assert np.array_equal(flat[:900].reshape(9, 10, 10).argmax(axis=0), observation["grid"])
    assert np.array_equal(flat[900:], observation["telemetry"])
