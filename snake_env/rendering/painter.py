"""Draws scenes with Pillow, and writes them as a GIF."""

from __future__ import annotations

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
)
from snake_env.rendering.scenes import FRAMES_PER_SECOND, Scene
from snake_env.state import FloatArray
from snake_env.system.files import replacing

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

WIDTH, HEIGHT = 640, 480

_OVERSAMPLING = 2
_PAPER_COLOUR = "#fbfaf7"
_GHOST = "#cfdcea"
_POLYGON = "#dcefe3"
_NEAR_LIMIT = 0.85  # share of phi_limit from which a joint is shown in colour
_HEADER = 64  # pixels


class Painter:
    """Draws scenes; from :meth:`begin` on the view only ever widens, so that the picture does not jump.

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
        self.begin([])

    def begin(self, scenes: list[Scene], margin: float = 0.08) -> None:
        """Begins a new view: around some scenes and their targets, and so much more [m]."""
        self._low, self._high = np.full(2, np.inf), np.full(2, -np.inf)
        for scene in scenes:
            self._widen(*self._bodies(scene), margin=margin)

    def frame(self, scene: Scene) -> NDArray[np.uint8]:
        """The scene as an image, shape (480, 640, 3) uint8."""
        return np.asarray(self.image(scene), dtype=np.uint8).copy()

    def image(self, scene: Scene) -> Image.Image:
        """The scene as a Pillow image, 640 x 480."""
        place, ghost = self._bodies(scene)
        self._widen(place, ghost)
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

    def _bodies(self, scene: Scene) -> tuple[Geometry, Geometry]:
        """Where the robot is, and its target."""
        target = geometry(scene.target, np.array(self.params.w_d), self.params)
        return geometry(scene.phi, scene.w, self.params), target

    def _widen(self, place: Geometry, ghost: Geometry, margin: float = 0.08) -> None:
        """Makes room for the robot and its target, with a margin [m]."""
        points = np.concatenate([place.outline, ghost.outline])
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
        for number, angle in enumerate(scene.phi, 1):
            share, own = abs(angle) / self.params.phi_limit, number == scene.scp
            usual = INK if own else "white"
            colour = LIFTED if share > 1 - 1e-3 else GRAVITY if share > _NEAR_LIMIT else usual
            self._dot(pen, place.outline[number], 7 if own else 5, colour)
        self._dot(pen, place.outline[0], 7, INK)
        ((x, y),) = self._pixels(place.gravity[None])
        arm = 8 * _OVERSAMPLING
        self._dot(pen, place.gravity, 6, LIFTED if scene.alarm == "stability" else GRAVITY)
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
    painter.begin(scenes)
    images = painter.quantized([painter.image(scene) for scene in scenes])
    durations = [1000 // FRAMES_PER_SECOND] * (len(images) - 1) + [2000]
    more: dict[str, Any] = {"append_images": images[1:], "duration": durations, "loop": 0}
    with replacing(Path(path)) as file:
        images[0].save(file, "GIF", save_all=True, **more)
