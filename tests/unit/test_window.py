"""The window of the render mode `human`."""

import re
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from drone_env.core.episode import Episode
from drone_env.envs.drone_delivery import Window
from drone_env.envs.rendering import draw_picture
from drone_env.installer import install_command


@pytest.fixture
def pygame(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """pygame on a screen that is not there."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    import pygame

    yield pygame
    pygame.display.quit()


class TestWindow:
    def test_opens_with_the_first_picture_and_follows_their_size(self, pygame: Any) -> None:
        window = Window(fps=1000)
        assert not window.is_open
        assert not pygame.display.get_init()
        picture = draw_picture(Episode("easy", seed=7), 200)
        for view in (picture, picture[::2, ::-2]):
            window.show(view)
            assert window.is_open
            shown = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
            assert np.array_equal(shown, view)

    def test_closed_by_its_x_it_stays_closed(self, pygame: Any) -> None:
        window, picture = Window(fps=1000), np.zeros((20, 30, 3), np.uint8)
        window.show(picture)
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        for _ in range(2):
            window.show(picture)
            assert not window.is_open
        assert not pygame.display.get_init()
        window.close()
        window.show(picture)
        assert window.is_open

    def test_missing_pygame_is_named(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "pygame", None)
        window = Window()
        with pytest.raises(DependencyNotInstalled, match=re.escape(install_command("human"))):
            window.show(np.zeros((20, 30, 3), np.uint8))
        assert not window.is_open
        window.close()
