"""Draws the robot from above with matplotlib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.kinematics import locate, to_world
from snake_env.equations.stability import contacts
from snake_env.errors import MissingDependencyError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.state import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#1f2933"
BODY = "#7b8794"
GROUNDED = "#0b6e4f"
LIFTED = "#d1495b"
SUPPORT = "#9ad1b3"
TARGET = "#3a6ea5"
GRAVITY = "#f2a541"


@dataclass(frozen=True, eq=False)
class Geometry:
    """Places of the robot's parts in the world [m].

    Attributes:
        outline: Head point, yaw joints J_1..J_n and tail tip, shape (n + 2, 2).
        centres: Link centres W_0..W_n, shape (n + 1, 2).
        axles: Left and right wheel of axles 1..n, shape (n, 2, 2).
        head_contact: W_0, shape (1, 2), or (0, 2) where link 0 does not touch the ground.
        gravity: Centre of gravity, shape (2,).
    """

    outline: FloatArray
    centres: FloatArray
    axles: FloatArray
    head_contact: FloatArray
    gravity: FloatArray


def geometry(phi: FloatArray, w: FloatArray, params: SnakeParams) -> Geometry:
    """Places of the robot's parts for joint angles ``phi`` (n,) [rad] and head pose ``w`` (3,)."""
    body = locate([float(angle) for angle in phi], params.l)
    points = contacts(body, params)
    wheels = to_world([point for k, point in points if k > 0], w)
    heads = [point for k, point in points if k == 0]
    centres = to_world(body.centres, w)
    return Geometry(
        outline=to_world([*body.joints, body.tail], w),
        centres=centres,
        axles=wheels.reshape(-1, 2, 2),
        head_contact=to_world(heads, w),
        gravity=centres.mean(axis=0),
    )


def lifted_wheels(mode: int, phase: int, params: SnakeParams) -> NDArray[np.bool_]:
    """Which wheels are in the air in a mode and phase, the SCP's included, shape (n,)."""
    table = mode_table(params.n_joints)
    lifted: NDArray[np.bool_] = table.lifted_wheels(np.array([mode]), np.array([phase]))[0]
    return lifted


def draw_robot(
    ax: Axes,
    phi: FloatArray,
    w: FloatArray,
    lifted: NDArray[np.bool_],
    params: SnakeParams,
    target: FloatArray | None = None,
) -> None:
    """Draws the body, its wheels, the support polygon, the centre of gravity and the target shape.

    Args:
        ax: Where to draw; its aspect is made equal.
        phi: Joint angles, shape (n,) [rad].
        w: Head pose, shape (3,) [m, m, rad].
        lifted: Wheels in the air, shape (n,).
        params: The constants.
        target: Target joint angles, shape (n,) [rad]; drawn as a ghost.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        from matplotlib.patches import Polygon
    except ImportError:
        raise MissingDependencyError(
            "drawing needs matplotlib: pip install snake-mode-env[render]"
        ) from None
    ax.set_aspect("equal")
    if target is not None:
        ghost = geometry(target, np.array(params.w_d), params).outline
        ax.plot(*ghost.T, color=TARGET, lw=5, alpha=0.25, solid_joinstyle="round", zorder=1)
        ax.plot(*ghost.T, color=TARGET, lw=1, ls=(0, (4, 3)), zorder=2)
    place = geometry(phi, w, params)
    on_ground = np.concatenate([place.head_contact, place.axles[~lifted].reshape(-1, 2)])
    hull = convex_hull(on_ground)
    ax.add_patch(Polygon(hull, facecolor=SUPPORT, edgecolor=GROUNDED, alpha=0.35, lw=0.8, zorder=0))
    ax.plot(*place.outline.T, color=BODY, lw=4.5, solid_joinstyle="round", zorder=3)
    ax.plot(*place.outline[1:-1].T, "o", color="white", mec=INK, ms=4.5, mew=0.9, zorder=5)
    ax.plot(*place.outline[0], "o", color=INK, ms=7, zorder=6)
    for axle, up in zip(place.axles, lifted, strict=True):
        style: dict[str, Any] = (
            {"color": LIFTED, "lw": 1.0, "ls": (0, (1.5, 1.5)), "mfc": "white"}
            if up
            else {"color": GROUNDED, "lw": 1.6, "ls": "-", "mfc": GROUNDED}
        )
        ax.plot(*axle.T, marker="s", ms=4.5, mew=1.0, zorder=4, **style)
    ax.plot(*place.gravity, marker="P", color=GRAVITY, mec=INK, mew=0.8, ms=9, zorder=7)


def convex_hull(points: FloatArray) -> FloatArray:
    """Corners of the convex hull of points (k, 2), anticlockwise (Andrew's monotone chain)."""
    ordered = sorted(map(tuple, points))

    def half(sequence: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
        chain: list[tuple[float, ...]] = []
        for x, y in sequence:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                chain.pop()
            chain.append((x, y))
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))
