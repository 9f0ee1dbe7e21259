"""The cost V of (19)-(20) and its gradient (14), on generic scalars.

The gradient is exact. Turning joint m moves everything behind it as one rigid body about J_m, so one
pass from tail to head collects the "forces" dV/dp and the "torques" about the origin.
"""

from __future__ import annotations

from collections.abc import Sequence

from snake_env.equations.kinematics import Body, guarded_pairs, squared_distance
from snake_env.equations.scalars import (
    Bool,
    Scalar,
    absolute,
    maximum,
    minimum,
    select,
    sqrt,
    total,
)
from snake_env.params import SnakeParams

Cost = tuple[Scalar, Scalar, list[Scalar]]
"""A term of V; and its gradient (n values), of which a common factor comes first."""


def limit_cost(phi: Sequence[Scalar], rear: Sequence[Bool], p: SnakeParams) -> Cost:
    """V_L of (19): cubes of how far rear joints exceed c_phi."""
    terms: list[Scalar] = []
    slopes: list[Scalar] = []
    for angle, behind in zip(phi, rear, strict=True):
        beyond = angle - maximum(minimum(angle, p.c_phi), -p.c_phi)
        excess = select(behind, beyond, 0.0)  # (20), with the angle's sign
        slopes.append(excess * absolute(excess))
        terms.append(slopes[-1] * excess)
    return total(terms), 3.0, slopes


def collision_cost(body: Body, rear: Sequence[Bool], p: SnakeParams) -> Cost:
    """V_c of (19): cubes of how much closer than d_0 links come."""
    n = body.n_joints
    terms: list[Scalar] = []
    forces: dict[int, tuple[Scalar, Scalar]] = {}

    def push(i: int, fx: Scalar, fy: Scalar) -> None:
        old = forces.get(i)
        forces[i] = (fx, fy) if old is None else (old[0] + fx, old[1] + fy)

    for i, j in guarded_pairs(n):
        (xi, yi), (xj, yj) = body.guarded_point(i), body.guarded_point(j)
        dx, dy = xi - xj, yi - yj
        distance = sqrt(squared_distance(body, i, j))
        nearness = select(rear[i - 1], maximum(p.d_0 - distance, 0.0), 0.0)  # (20)
        terms.append(nearness * nearness * nearness)
        force = nearness * nearness / distance
        push(i, force * dx, force * dy)
        push(j, -(force * dx), -(force * dy))

    slopes: list[Scalar] = [0.0] * n
    fx: Scalar = 0.0
    fy: Scalar = 0.0
    torque: Scalar = 0.0
    for m in range(n, 0, -1):
        if m in forces:
            (px, py), (gx, gy) = body.guarded_point(m), forces[m]
            fx, fy = fx + gx, fy + gy
            torque = torque + (px * gy - py * gx)
        jx, jy = body.joints[m]
        slopes[m - 1] = torque - (jx * fy - jy * fx)
    return total(terms), -3.0, slopes


def singularity_cost(body: Body, grounded: Sequence[Bool], p: SnakeParams) -> Cost:
    """V_s of (19): 1 / det(A-bar^T A-bar), where below the floor it is constant.

    In the head's frame row k of A in (1) is ``(-sin, cos, e_k . W_k)``.
    """
    n = body.n_joints
    rows: list[tuple[Scalar, Scalar, Scalar]] = []
    for k in range(1, n + 1):
        (cosine, sine), (wx, wy) = body.directions[k], body.centres[k]
        on = grounded[k - 1]
        lever = cosine * wx + sine * wy
        rows.append((select(on, -sine, 0.0), select(on, cosine, 0.0), select(on, lever, 0.0)))

    def gram(a: int, b: int) -> Scalar:
        return total([row[a] * row[b] for row in rows])

    xx, xy, xz, yy, yz, zz = (
        gram(a, b) for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    # Adjugate of the Gram matrix: det' = 2 sum_k (adj a_k) . a_k'.
    c_xx, c_xy, c_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c_yy, c_yz, c_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    det = xx * c_xx + xy * c_xy + xz * c_xz
    value = 1.0 / maximum(det, p.det_floor)
    factor = select(det > p.det_floor, -2.0 * (value * value), 0.0)

    slopes: list[Scalar] = [0.0] * n
    spin: Scalar = 0.0
    pull_x: Scalar = 0.0
    pull_y: Scalar = 0.0
    for m in range(n, 0, -1):
        ax, ay, az = rows[m - 1]
        bx = c_xx * ax + c_xy * ay + c_xz * az
        by = c_xy * ax + c_yy * ay + c_yz * az
        bz = c_xz * ax + c_yz * ay + c_zz * az
        # Turning row k by joint m: (-sin, cos)' = -e_k and lever' = nrm_k . J_m.
        spin = spin + (by * ax - bx * ay)
        pull_x, pull_y = pull_x + bz * ax, pull_y + bz * ay
        jx, jy = body.joints[m]
        slopes[m - 1] = spin + (pull_x * jx + pull_y * jy)
    return value, factor, slopes


def cost_and_gradient(
    body: Body,
    phi: Sequence[Scalar],
    rear: Sequence[Bool],
    grounded: Sequence[Bool],
    p: SnakeParams,
) -> tuple[Scalar, list[Scalar]]:
    """V of (19) and eta = dV/dphi of (14).

    Args:
        body: The robot's body at ``phi``.
        phi: Joint angles, n values [rad].
        rear: Marks of the joints behind the SCP, n values.
        grounded: Marks of the wheels on the ground, n values.
        p: The constants.

    Returns:
        V, and its gradient (n values).
    """
    weighted = (
        (p.a_l, limit_cost(phi, rear, p)),
        (p.a_c, collision_cost(body, rear, p)),
        (p.a_s, singularity_cost(body, grounded, p)),
    )
    value = total([weight * v for weight, (v, _, _) in weighted])
    scaled = [(weight * factor, slopes) for weight, (_, factor, slopes) in weighted]
    gradient = [total([scale * slopes[m] for scale, slopes in scaled]) for m in range(len(phi))]
    return value, gradient
