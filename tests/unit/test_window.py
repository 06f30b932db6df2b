"""The window of the render mode `human`."""

import re
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from drone_env.envs.rendering import draw_picture
from drone_env.errors import install_command


def human() -> Any:
    env = gymnasium.make("drone_env:DroneDelivery-Easy-v1", render_mode="human").unwrapped
    env.reset(seed=7)
    return env


def test_it_shows_the_picture_until_the_environment_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # no real screen
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    import pygame

    env = human()
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert np.array_equal(shown, draw_picture(env.episode))
    env.close()
    assert not pygame.display.get_init()


def test_missing_pygame_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=re.escape(install_command("human"))):
        human().render()
