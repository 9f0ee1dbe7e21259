"""Frames of the moving robot, drawn with Pillow: for videos, GIFs and a window."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import MissingDependencyError
from snake_env.params import SnakeParams
from snake_env.rendering.drawing import (
    BODY,
    GRAVITY,
    GROUNDED,
    INK,
    LIFTED,
    SUPPORT,
    TARGET,
    Geometry,
    convex_hull,
    geometry,
    lifted_wheels,
)
from snake_env.sim.simulation import trajectory
from snake_env.state import FloatArray, SnakeState

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

FRAMES_PER_SECOND = 20
FRAME_EVERY_S = 0.15  # of the robot's time: videos run three times as fast as the robot
WIDTH, HEIGHT = 640, 480

_OVERSAMPLING = 2
_PAPER_COLOUR = "#fbfaf7"
_GHOST = "#cfdcea"
_POLYGON = "#dcefe3"
_NEAR_LIMIT = 0.85  # share of phi_limit from which a joint is shown in colour
_HEADER = 64  # pixels


@dataclass(frozen=True, eq=False)
class Scene:
    """What a frame shows.

    Attributes:
        phi: Joint angles, shape (n,) [rad].
        w: Head pose, shape (3,) [m, m, rad].
        target: Target joint angles, shape (n,) [rad].
        lifted: Wheels in the air, shape (n,).
        time: Time since the episode began [s].
        caption: Phase and mode in words.
        alarm: What went wrong, or empty.
    """

    phi: FloatArray
    w: FloatArray
    target: FloatArray
    lifted: NDArray[np.bool_]
    time: float
    caption: str
    alarm: str = ""


def motion_scenes(
    before: SnakeState, mode: int, params: SnakeParams, *, alarm: str = ""
) -> list[Scene]:
    """Scenes of an interval, one every :data:`FRAME_EVERY_S` and one at its end.

    Args:
        before: The robot at t_k.
        mode: The mode, valid in its phase.
        params: The constants.
        alarm: What the last scene warns of.
    """
    motion = trajectory(before, mode, params)
    steps = len(motion.u)
    every = max(1, round(FRAME_EVERY_S / params.dt))
    shown = [*range(every, steps, every), steps]
    lifted = lifted_wheels(mode, before.phase, params)
    caption = f"phase {before.phase}   mode {mode}"
    return [
        Scene(
            phi=motion.phi[k],
            w=motion.w[k],
            target=before.target,
            lifted=lifted,
            time=before.elapsed + k * params.dt,
            caption=caption,
            alarm=alarm if k == steps else "",
        )
        for k in shown
    ]


def still_scene(state: SnakeState, params: SnakeParams, *, alarm: str = "") -> Scene:
    """The robot at a switching time, with no more wheels in the air than the phase demands."""
    done = state.done
    up = lifted_wheels(0, state.phase, params)  # none once the target is reached
    return Scene(
        phi=state.phi,
        w=state.w,
        target=state.target,
        lifted=up,
        time=state.elapsed,
        caption="target reached" if done else f"phase {state.phase}",
        alarm=alarm,
    )


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
        self._add([still_scene(state, self.params)])

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


class Painter:
    """Draws scenes; the view only ever widens, so that the picture does not jump.

    Raises:
        MissingDependencyError: Pillow is not installed.
    """

    def __init__(self, params: SnakeParams) -> None:
        try:
            from PIL import Image, ImageDraw, ImageFont
        except ImportError:
            raise MissingDependencyError(
                "drawing needs Pillow: pip install snake-mode-env[render]"
            ) from None
        self.params = params
        self._image, self._draw = Image, ImageDraw
        self._large = ImageFont.load_default(17 * _OVERSAMPLING)
        self._small = ImageFont.load_default(13 * _OVERSAMPLING)
        reach = 2.0 * params.l * (params.n_joints + 1)
        head = np.array(params.w_d[:2])
        ahead = -0.5 * reach * np.array([np.cos(params.w_d[2]), np.sin(params.w_d[2])])
        self._low = head + ahead - [0.62 * reach, 0.4 * reach]
        self._high = head + ahead + [0.62 * reach, 0.4 * reach]

    def frame(self, scene: Scene) -> NDArray[np.uint8]:
        """The scene as an image, shape (480, 640, 3) uint8."""
        return np.asarray(self.image(scene), dtype=np.uint8).copy()

    def image(self, scene: Scene) -> Image.Image:
        """The scene as a Pillow image, 640 x 480."""
        place = geometry(scene.phi, scene.w, self.params)
        ghost = geometry(scene.target, np.array(self.params.w_d), self.params)
        self.widen(np.concatenate([place.outline, ghost.outline]))
        size = (WIDTH * _OVERSAMPLING, HEIGHT * _OVERSAMPLING)
        image = self._image.new("RGB", size, _PAPER_COLOUR)
        pen = self._draw.Draw(image)
        self._draw_ghost(pen, ghost)
        self._draw_support(pen, scene, place)
        self._draw_body(pen, scene, place)
        self._draw_header(pen, scene)
        return image.resize((WIDTH, HEIGHT), self._image.Resampling.LANCZOS)

    def quantized(self, images: list[Image.Image]) -> list[Image.Image]:
        """The images in a common palette in which even the smallest marks keep their colours."""
        sample = images[len(images) // 2].copy()
        pen = self._draw.Draw(sample)
        for k, colour in enumerate((GRAVITY, LIFTED, GROUNDED, INK, BODY, TARGET, SUPPORT, _GHOST)):
            pen.rectangle((0, 20 * k, 60, 20 * k + 19), fill=colour)
        palette = sample.quantize(128)
        no_dither = self._image.Dither.NONE
        return [image.quantize(palette=palette, dither=no_dither) for image in images]

    def widen(self, points: FloatArray) -> None:
        """Makes room for points (k, 2) [m]."""
        margin = 0.08
        self._low = np.minimum(self._low, points.min(axis=0) - margin)
        self._high = np.maximum(self._high, points.max(axis=0) + margin)

    def _scale(self) -> float:
        """Pixels per metre."""
        span = self._high - self._low
        room = np.array([WIDTH, HEIGHT - _HEADER]) * _OVERSAMPLING
        return float((room / span).min())

    def _pixels(self, points: FloatArray) -> list[tuple[float, float]]:
        middle = np.array([WIDTH / 2, (HEIGHT + _HEADER) / 2]) * _OVERSAMPLING
        offset = (points - (self._low + self._high) / 2) * [1.0, -1.0] * self._scale()
        return [(float(x), float(y)) for x, y in offset + middle]

    def _thick_line(
        self, pen: ImageDraw.ImageDraw, points: FloatArray, width: float, colour: str
    ) -> None:
        pixels = self._pixels(points)
        half = 0.5 * width * _OVERSAMPLING
        pen.line(pixels, fill=colour, width=round(2 * half), joint="curve")
        for x, y in pixels:
            pen.ellipse((x - half, y - half, x + half, y + half), fill=colour)

    def _draw_ghost(self, pen: ImageDraw.ImageDraw, ghost: Geometry) -> None:
        self._thick_line(pen, ghost.outline, 11, _GHOST)
        for start, stop in zip(ghost.outline[:-1], ghost.outline[1:], strict=True):
            for k in range(0, 8, 2):
                dash = start + np.outer([k / 8, (k + 1) / 8], stop - start)
                pen.line(self._pixels(dash), fill=TARGET, width=_OVERSAMPLING)

    def _draw_support(self, pen: ImageDraw.ImageDraw, scene: Scene, place: Geometry) -> None:
        wheels = place.axles[~scene.lifted].reshape(-1, 2)
        contacts = np.concatenate([place.head_contact, wheels])
        if len(contacts) > 2:
            hull = self._pixels(convex_hull(contacts))
            pen.polygon(hull, fill=_POLYGON, outline=SUPPORT, width=_OVERSAMPLING)

    def _draw_body(self, pen: ImageDraw.ImageDraw, scene: Scene, place: Geometry) -> None:
        for axle, up in zip(place.axles, scene.lifted, strict=True):
            pixels = self._pixels(axle)
            pen.line(pixels, fill=LIFTED if up else GROUNDED, width=2 * _OVERSAMPLING)
        self._thick_line(pen, place.outline, 9, BODY)
        for axle, up in zip(place.axles, scene.lifted, strict=True):
            self._draw_wheels(pen, axle, bool(up))
        for joint, angle in zip(place.outline[1:-1], scene.phi, strict=True):
            share = abs(angle) / self.params.phi_limit
            colour = LIFTED if share > 1 - 1e-3 else GRAVITY if share > _NEAR_LIMIT else "white"
            self._dot(pen, joint, 5, colour)
        self._dot(pen, place.outline[0], 7, INK)
        ((x, y),) = self._pixels(place.gravity[None])
        arm = 8 * _OVERSAMPLING
        self._dot(pen, place.gravity, 6, GRAVITY)
        pen.line((x - arm, y, x + arm, y), fill=INK, width=_OVERSAMPLING)
        pen.line((x, y - arm, x, y + arm), fill=INK, width=_OVERSAMPLING)

    def _draw_wheels(self, pen: ImageDraw.ImageDraw, axle: FloatArray, up: bool) -> None:
        across = (axle[1] - axle[0]) / np.linalg.norm(axle[1] - axle[0])
        along = np.array([-across[1], across[0]])
        for wheel in axle:
            corners = (
                wheel
                + 0.028 * np.outer([1, 1, -1, -1], along)
                + 0.012 * np.outer([1, -1, -1, 1], across)
            )
            pen.polygon(
                self._pixels(corners),
                fill=_PAPER_COLOUR if up else GROUNDED,
                outline=LIFTED if up else GROUNDED,
                width=_OVERSAMPLING,
            )

    def _dot(self, pen: ImageDraw.ImageDraw, point: FloatArray, radius: float, colour: str) -> None:
        ((x, y),) = self._pixels(point[None])
        r = radius * _OVERSAMPLING
        pen.ellipse(
            (x - r, y - r, x + r, y + r), fill=colour, outline=INK, width=max(1, _OVERSAMPLING)
        )

    def _draw_header(self, pen: ImageDraw.ImageDraw, scene: Scene) -> None:
        left, right = 14 * _OVERSAMPLING, (WIDTH - 14) * _OVERSAMPLING
        top, below = 10 * _OVERSAMPLING, 36 * _OVERSAMPLING
        pen.text((left, top), scene.caption, fill=INK, font=self._large)
        pen.text((right, top), f"{scene.time:.1f} s", fill=INK, font=self._large, anchor="ra")
        up = " ".join(str(k) for k in np.flatnonzero(scene.lifted) + 1)
        pen.text((left, below), f"wheels lifted: {up or 'none'}", fill=LIFTED, font=self._small)
        if scene.alarm:
            text = scene.alarm.replace("_", " ")
            pen.text((right, below), text, fill=LIFTED, font=self._small, anchor="ra")


def save_gif(scenes: list[Scene], path: str | Path, params: SnakeParams) -> None:
    """Writes scenes as an animated GIF (and shows the last one for two seconds).

    Raises:
        MissingDependencyError: Pillow is not installed.
    """
    painter = Painter(params)
    for scene in scenes:  # widens the view to its final size first
        painter.widen(geometry(scene.phi, scene.w, params).outline)
    images = painter.quantized([painter.image(scene) for scene in scenes])
    durations = [1000 // FRAMES_PER_SECOND] * (len(images) - 1) + [2000]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0)
