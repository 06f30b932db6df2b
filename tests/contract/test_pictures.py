"""Pictures as those ask for them who show or record environments."""

from copy import deepcopy
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.vec_env.base_vec_env import tile_images

from drone_env.core.tasks import get_task
from drone_env.envs.drone_delivery import DroneDeliveryEnv
from drone_env.envs.rendering import draw_picture
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.envs.vector import SIZE, DroneDeliveryVectorEnv
from drone_env.errors import InvalidValueError

EASY = "drone_env:DroneDelivery-Easy-v1"
SHORT = replace(get_task("easy"), max_steps=3)


def actions_of(step: int) -> np.ndarray:
    return np.array([step % 5, (step + 1) % 4])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda mode: mode.value)
def test_a_batch_shows_what_single_environments_show(mode: AutoresetMode) -> None:
    ours = DroneDeliveryVectorEnv(2, SHORT, autoreset_mode=mode, render_mode="rgb_array")
    theirs = SyncVectorEnv([lambda: DroneDeliveryEnv(SHORT)] * 2, autoreset_mode=mode)

    def assert_shown(env: DroneDeliveryVectorEnv) -> None:
        shown = env.render()
        assert isinstance(shown, tuple)
        wanted = [draw_picture(single.episode, SIZE) for single in theirs.envs]  # type: ignore[attr-defined]
        assert np.array_equal(shown, wanted)

    for env in (ours, theirs):
        env.reset(seed=11)
    assert_shown(ours)
    for step in range(6):
        for env in (ours, theirs):
            env.step(actions_of(step))
        assert_shown(ours)
    copied = deepcopy(ours)
    one = {"options": {"reset_mask": np.array([False, True])}, "seed": [None, 11]}
    for env in (copied, theirs):
        env.reset(**one)
    assert_shown(copied)


def test_a_batch_has_pictures_by_its_id_where_they_are_asked_for() -> None:
    env = gymnasium.make_vec(EASY, num_envs=2, render_mode="rgb_array")
    assert env.render_mode == "rgb_array"
    assert (env.metadata["render_modes"], env.metadata["render_fps"]) == (["rgb_array"], 8)
    with pytest.raises(ResetNeeded, match="nothing to show"):
        env.render()
    with pytest.raises(InvalidValueError, match="unknown render_mode 'human'; a batch allows: rgb_array"):
        gymnasium.make_vec(EASY, num_envs=2, render_mode="human")


def test_sb3_gets_pictures_of_all_drones() -> None:
    env = DroneDeliveryVecEnv(SHORT, 2, render_mode="rgb_array")
    assert (env.render_mode, env.metadata["render_fps"]) == ("rgb_array", 8)
    twin = DroneDeliveryVectorEnv(2, SHORT, autoreset_mode="SAME_STEP", render_mode="rgb_array")
    env.seed(5)
    env.reset()
    twin.reset(seed=5)
    for step in range(4):
        env.step(actions_of(step))
        twin.step(actions_of(step))
    images = env.get_images()
    assert np.array_equal(images, twin.render())
    assert np.array_equal(env.render(), tile_images(images))


def test_arrows_letters_and_space_fly_where_they_point() -> None:
    import pygame

    keys = DroneDeliveryEnv().get_keys_to_action()
    arrows = (pygame.K_UP, pygame.K_DOWN, pygame.K_LEFT, pygame.K_RIGHT)
    assert [keys[(key,)] for key in (*arrows, ord(" "), *map(ord, "wsad."))] == [*range(5), *range(5)]
