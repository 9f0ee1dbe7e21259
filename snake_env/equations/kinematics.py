"""Where the links are: joints and link centres from joint angles, on generic scalars.

Everything is in the head's frame (head point at the origin, link 0 along -x), because the cost, the
stability and the joint input do not depend on where the head is: only its velocity enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.scalars import Scalar, minimum, sin_cos, total

Point = tuple[Scalar, Scalar]

_TINY = 1e-300


@dataclass(frozen=True)
class Body:
    """The links' directions and places in the head's frame, lengths in m.

    Attributes:
        directions: ``e(theta_k - theta_0)`` = (cos, sin) for links 0..n.
        joints: Yaw joints ``J_1..J_n``; ``joints[0]`` is the head point.
        centres: Link centres ``W_0..W_n``; wheel axle k >= 1 sits at ``W_k``.
        tail: The tail's tip.
    """

    directions: list[Point]
    joints: list[Point]
    centres: list[Point]
    tail: Point

    @property
    def n_joints(self) -> int:
        """Number of yaw joints."""
        return len(self.joints) - 1

    def guarded_point(self, i: int) -> Point:
        """Point p_i of (19), for 1 <= i <= n: a link's centre, or the tail's tip for i = n."""
        return self.tail if i == self.n_joints else self.centres[i]


def locate(phi: Sequence[Scalar], l: Scalar) -> Body:  # noqa: E741
    """Body of the robot with joint angles ``phi`` (n values, rad) and half link length ``l`` [m]."""
    directions: list[Point] = [(1.0, 0.0)]
    heading: Scalar = 0.0
    for k, angle in enumerate(phi):
        heading = angle if k == 0 else heading + angle
        sine, cosine = sin_cos(heading)
        directions.append((cosine, sine))
    front: Point = (0.0, 0.0)
    joints, centres = [front], []
    for k, (cosine, sine) in enumerate(directions):
        if k > 0:
            joints.append(front)
        centres.append((front[0] - l * cosine, front[1] - l * sine))
        front = (front[0] - 2.0 * l * cosine, front[1] - 2.0 * l * sine)
    return Body(directions, joints, centres, tail=front)


def guarded_pairs(n_joints: int) -> list[tuple[int, int]]:
    """Pairs (i, j), 1 <= j <= i - 3, i <= n, whose distances V_c and d_min watch, (19)."""
    return [(i, j) for i in range(4, n_joints + 1) for j in range(1, i - 2)]


def squared_distance(body: Body, i: int, j: int) -> Scalar:
    """Square of d_{i,j} in (19) [m^2]; never 0, so that (14) stays finite where links coincide."""
    (xi, yi), (xj, yj) = body.guarded_point(i), body.guarded_point(j)
    dx, dy = xi - xj, yi - yj
    return dx * dx + (dy * dy + _TINY)


def least_squared_distance(body: Body) -> Scalar:
    """Square of d_min [m^2]: the least distance over all guarded pairs."""
    pairs = guarded_pairs(body.n_joints)
    least = squared_distance(body, *pairs[0])
    for pair in pairs[1:]:
        least = minimum(squared_distance(body, *pair), least)
    return least


def centre_of_gravity(body: Body) -> Point:
    """Mean of the n + 1 link centres, whose masses are equal, (22)."""
    share = 1.0 / len(body.centres)
    return (
        total([x for x, _ in body.centres]) * share,
        total([y for _, y in body.centres]) * share,
    )


def to_world(points: Sequence[Point], w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the head's frame, (k, 2) [m], placed by the head's pose ``w`` (3,) [m, m, rad]."""
    local = np.array(points, dtype=np.float64).reshape(-1, 2)
    cosine, sine = np.cos(w[2]), np.sin(w[2])
    placed: NDArray[np.float64] = local @ np.array([[cosine, sine], [-sine, cosine]]) + w[:2]
    return placed
