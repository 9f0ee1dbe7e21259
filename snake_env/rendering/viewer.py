"""The env's render modes: frames of an episode, in arrays or in a window."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import MissingDependencyError
from snake_env.params import SnakeParams
from snake_env.rendering.painter import HEIGHT, WIDTH, Painter
from snake_env.rendering.scenes import FRAMES_PER_SECOND, Scene, motion_scenes, still_scene
from snake_env.state import SnakeState

_ROOM = 2.0  # around start and target, for the motion between them, in links' half lengths


class Viewer:
    """Turns an episode into frames, for the env's render modes.

    Args:
        params: The constants.
        mode: ``human``, ``rgb_array`` or ``rgb_array_list``.

    Raises:
        MissingDependencyError: Pillow is not installed, or pygame for ``human``.
    """

    def __init__(self, params: SnakeParams, mode: str) -> None:
        self.params = params
        self._mode = mode
        self._painter = Painter(params)
        self._window = _Window() if mode == "human" else None
        self._scenes: list[Scene] = []

    def begin(self, state: SnakeState) -> None:
        """Shows where an episode begins."""
        self._scenes = []
        scene = still_scene(state, self.params)
        self._painter.begin([scene], margin=_ROOM * self.params.l)
        self._add([scene])

    def show(self, before: SnakeState, mode: int, after: SnakeState, violation: str) -> None:
        """Shows an interval: the motion inside it, or that the robot held still."""
        held = np.array_equal(before.phi, after.phi) and bool(violation)
        if held:
            self._add([still_scene(after, self.params, alarm=violation)])
        else:
            self._add(motion_scenes(before, mode, self.params, alarm=violation))

    def frame(self) -> NDArray[np.uint8]:
        """The last frame, shape (480, 640, 3)."""
        return self._painter.frame(self._scenes[-1])

    def take(self) -> list[NDArray[np.uint8]]:
        """The frames since the last call."""
        frames = [self._painter.frame(scene) for scene in self._scenes]
        self._scenes = []
        return frames

    def close(self) -> None:
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _add(self, scenes: list[Scene]) -> None:
        if self._window is not None:
            for scene in scenes:
                self._window.show(self._painter.frame(scene))
        self._scenes = scenes[-1:] if self._mode != "rgb_array_list" else [*self._scenes, *scenes]


class _Window:
    """The pygame window: pygame has a single one, which closes with the last that shows in it."""

    _users = 0

    def __init__(self) -> None:
        try:
            import pygame
        except ImportError:
            raise MissingDependencyError(
                "render_mode 'human' needs pygame: pip install snake-mode-env[render]"
            ) from None
        self._pygame: Any = pygame
        pygame.display.init()
        pygame.display.set_caption("snake-mode-env")
        self._screen = pygame.display.set_mode((WIDTH, HEIGHT))
        self._clock = pygame.time.Clock()
        _Window._users += 1

    def show(self, frame: NDArray[np.uint8]) -> None:
        surface = self._pygame.surfarray.make_surface(frame.swapaxes(0, 1))
        self._screen.blit(surface, (0, 0))
        self._pygame.event.pump()
        self._pygame.display.flip()
        self._clock.tick(FRAMES_PER_SECOND)

    def close(self) -> None:
        _Window._users -= 1
        if _Window._users == 0:
            self._pygame.display.quit()
