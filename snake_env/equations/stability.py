"""Static stability (22): is the centre of gravity strictly inside the support polygon?"""

from __future__ import annotations

from collections.abc import Sequence

from snake_env.equations.kinematics import Body, Point, centre_of_gravity
from snake_env.equations.scalars import Bool, Scalar, both, either, negate, select
from snake_env.params import SnakeParams


def _cross(a: Point, b: Point) -> Scalar:
    return a[0] * b[1] - a[1] * b[0]


def _dot(a: Point, b: Point) -> Scalar:
    return a[0] * b[0] + a[1] * b[1]


def _choose(condition: Bool, if_true: Point, if_false: Point) -> Point:
    return select(condition, if_true[0], if_false[0]), select(condition, if_true[1], if_false[1])


def contacts(body: Body, p: SnakeParams) -> list[tuple[int, Point]]:
    """Points that may touch the ground: ``(0, W_0)``, then ``(k, left)``, ``(k, right)`` per axle.

    Link 0's own contact is there only where ``p.head_contact``. Points in the head's frame [m].
    """
    points: list[tuple[int, Point]] = [(0, body.centres[0])] if p.head_contact else []
    half = 0.5 * p.track
    for k in range(1, body.n_joints + 1):
        (cosine, sine), (x, y) = body.directions[k], body.centres[k]
        dx, dy = -(half * sine), half * cosine
        points += [(k, (x + dx, y + dy)), (k, (x - dx, y - dy))]
    return points


def statically_stable(body: Body, grounded: Sequence[Bool], p: SnakeParams) -> Bool:
    """(22): whether the centre of gravity lies strictly inside the hull of the contacts.

    Seen from the centre of gravity, the contacts met so far fill a wedge from direction ``right`` to
    direction ``left``. It grows contact by contact until one falls opposite to it: then, and only
    then, the contacts surround the centre of gravity. No hull has to be built. A contact may lie
    exactly opposite while the wedge is still a single ray. Then the contacts surround the centre of
    gravity if the wedge opens to both sides of that ray.

    Args:
        body: The robot's body.
        grounded: Marks of the wheels on the ground, n values.
        p: The constants.
    """
    cx, cy = centre_of_gravity(body)
    surrounded: Bool = False
    started: Bool = False
    opposed: Bool = False
    opened_right: Bool = False
    opened_left: Bool = False
    right: Point = (0.0, 0.0)
    left: Point = (0.0, 0.0)
    for k, (x, y) in contacts(body, p):
        touches: Bool = True if k == 0 else grounded[k - 1]
        if touches is False:
            continue
        point = _choose(touches, (x - cx, y - cy), (0.0, 0.0))  # (0, 0) changes nothing below
        begins = both(touches, negate(started))
        to_right = both(started, _cross(right, point) < 0.0)
        to_left = both(started, _cross(left, point) > 0.0)
        opened_right = either(opened_right, to_right)
        opened_left = either(opened_left, to_left)
        is_ray = both(started, negate(either(opened_right, opened_left)))
        opposed = either(opposed, both(is_ray, _dot(right, point) < 0.0))
        right = _choose(either(begins, to_right), point, right)
        left = _choose(either(begins, to_left), point, left)
        started = either(started, touches)
        surrounded = either(surrounded, both(to_right, to_left))
    return either(surrounded, both(opposed, both(opened_right, opened_left)))
