"""A window that shows frames and hears keys. Needs pygame-ce: ``pip install "uavbench[human]"``."""

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Window:
    """A window, opened at its first picture.

    Raises
    ------
    ImportError
        When pygame-ce is missing.
    """

    def __init__(self) -> None:
        try:
            self._pygame: Any = importlib.import_module("pygame")
        except ImportError:
            raise ImportError('a window needs pygame-ce: pip install "uavbench[human]"') from None
        self._screen: Any = None
        self._clock: Any = None

    def show(self, picture: NDArray[np.uint8], title: str, fps: float | None = None) -> None:
        """Show a picture, uint8 (rows, columns, 3), no more than ``fps`` of them a second."""
        pygame = self._pygame
        size = (picture.shape[1], picture.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            pygame.display.init()
            self._screen = pygame.display.set_mode(size)
            self._clock = pygame.time.Clock()
        pygame.display.set_caption(title)
        self._screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        if fps is not None:
            self._clock.tick(fps)

    def key(self) -> str | None:
        """Wait for a key and return its name; None when the window was closed."""
        pygame = self._pygame
        while True:
            event = pygame.event.wait()
            if event.type == pygame.QUIT:
                return None
            if event.type == pygame.KEYDOWN:
                return pygame.key.name(event.key)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
