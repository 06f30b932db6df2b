"""A window that shows pictures, for the render mode `human`."""

from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from drone_env.installer import how_to_install


class Window:
    """A window that opens with the first picture and changes its size with the pictures.

    When somebody closes it by its X, it stays closed and further pictures are ignored until `close` has been called,
    so that a running program goes on undisturbed.

    Args:
        fps: Pictures per second at most; `show` waits as long as that takes.
    """

    def __init__(self, fps: int = 8) -> None:
        self.fps = fps
        self._pygame: ModuleType | None = None
        self._clock: Any = None
        self._dismissed = False

    @property
    def is_open(self) -> bool:
        """Whether there is a window on the screen."""
        return self._pygame is not None

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture, one pixel of it per pixel of the screen.

        Args:
            picture: uint8[height, width, 3], RGB.

        Raises:
            gymnasium.error.DependencyNotInstalled: if pygame is missing.
            pygame.error: if there is no screen to open a window on.
        """
        if self._dismissed:
            return
        pygame = self._pygame or self._open()
        height, width = picture.shape[:2]
        screen = pygame.display.get_surface()
        if screen is None or screen.get_size() != (width, height):
            screen = pygame.display.set_mode((width, height))
        screen.blit(pygame.image.frombuffer(np.ascontiguousarray(picture), (width, height), "RGB"), (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            self._dismissed = True
            return
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window, if it is open. A later `show` opens a new one."""
        self._dismissed = False
        if self._pygame is not None:
            self._pygame.display.quit()
            self._pygame = self._clock = None

    def _open(self) -> ModuleType:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled(f"pygame is not installed; {how_to_install('human')}") from error
        pygame.display.init()
        pygame.display.set_caption("Drone delivery")
        self._pygame, self._clock = pygame, pygame.time.Clock()
        return pygame
