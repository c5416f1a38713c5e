"""A window that shows frames and reads keys. Needs pygame-ce: ``pip install "uavbench[human]"``."""

import importlib
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavbench.errors import UavbenchError

_PATIENCE = 100  # milliseconds to wait for an event
_REPEAT = (300, 80)  # milliseconds until a key that is held down repeats, and between further repeats


class WindowError(UavbenchError, RuntimeError):
    """Raised when a window cannot be opened; the message says why."""


class Window:
    """A window, which opens with its first picture.

    Attributes
    ----------
    closed : bool
        Whether the user has closed the window; then nothing more is shown.

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
        self.closed = False

    def show(self, picture: NDArray[np.uint8], title: str, fps: float | None = None) -> None:
        """Show a picture, uint8 (rows, columns, 3); with ``fps``, wait so that no more than that many are shown per second.

        Raises
        ------
        WindowError
            When there is no display.
        """
        pygame = self._pygame
        if not pygame.display.get_init():  # never opened, or another window of this process has closed the display
            self._screen = None
        if self._screen is not None and pygame.event.peek(pygame.QUIT):
            self.closed = True
        if self.closed:
            return
        size = (picture.shape[1], picture.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            self._open(size)
        pygame.display.set_caption(title)
        screen: Any = self._screen
        screen.blit(pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        if fps is not None:
            self._clock.tick(fps)

    def _open(self, size: tuple[int, int]) -> None:
        pygame = self._pygame
        try:
            pygame.display.init()
            # without a display, SDL falls back to an invisible one, and the program would wait for keys for ever
            if pygame.display.get_driver() == "offscreen" and os.environ.get("SDL_VIDEODRIVER") != "offscreen":
                pygame.display.quit()
                raise WindowError("there is no display to open a window on")
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise WindowError(f"there is no display to open a window on: {error}") from None
        pygame.key.set_repeat(*_REPEAT)
        self._clock = pygame.time.Clock()

    def key(self) -> str | None:
        """Wait for a key and return its name; None when the window was closed."""
        pygame = self._pygame
        while not self.closed:
            event = pygame.event.wait(_PATIENCE)  # not for ever, so that Python can handle Ctrl-C
            if event.type == pygame.QUIT:
                self.closed = True
            if event.type == pygame.KEYDOWN:
                return pygame.key.name(event.key)
        return None

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
