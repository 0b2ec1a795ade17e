"""The window of the render mode `human`. Needs the extra `human`: `pip install './python[human]'`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

__all__ = ["Window"]


class Window:
    """A window that opens with the first picture.

    A process has at most one, which shows the latest picture of all objects of this class. `close` of one closes it for
    all, and the next picture opens it again.

    Args:
        fps: The largest number of pictures per second. `show` waits accordingly.

    Raises:
        ImportError: If pygame is not installed.
    """

    def __init__(self, fps: int) -> None:
        """Import pygame."""
        with extra("human"):
            import pygame
        self.fps = fps
        self._pygame = pygame
        self._clock: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes another window."""
        return type(self), (self.fps,)

    def show(self, pictures: Sequence[NDArray[np.uint8]]) -> None:
        """Show pictures of shape (height, width, 3) and of equal size in a grid that is as large as one of them."""
        pygame, (height, width, _) = self._pygame, pictures[0].shape
        if self._clock is None:
            self._clock = pygame.time.Clock()
        # Another object may have closed the window or changed its size.
        screen = pygame.display.get_surface() if pygame.display.get_init() else None
        if screen is None or screen.get_size() != (width, height):
            pygame.display.init()
            screen = pygame.display.set_mode((width, height))
            pygame.display.set_caption("LogiCity")
        side = math.ceil(math.sqrt(len(pictures)))
        size = width // side, height // side
        for number, picture in enumerate(pictures):
            surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
            if side > 1:
                surface = pygame.transform.smoothscale(surface, size)
            row, column = divmod(number, side)
            screen.blit(surface, (column * size[0], row * size[1]))
        pygame.event.pump()
        self._clock.tick(self.fps)
        pygame.display.flip()

    def close(self) -> None:
        """Close the window."""
        if self._clock is not None:
            self._pygame.display.quit()
            self._clock = None
