"""The joint input: equations (7), (9)-(11), (16), (26)-(30), on generic scalars.

The velocity constraint (1) says that no wheel slides sideways. With ``B-tilde-prime`` of (7) lower
triangular, its inverse is a walk from head to tail: the velocity of joint k and the wheel on link k
fix how fast link k turns, and that fixes the velocity of joint k + 1. :func:`rolling_rates` is this
walk; it gives (10) when the head moves, and the null space of (11) when one lifted wheel does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from snake_env.equations.kinematics import Body
from snake_env.equations.scalars import (
    Bool,
    Scalar,
    absolute,
    dot,
    maximum,
    minimum,
    select,
    sin_cos,
    total,
)
from snake_env.params import SnakeParams

_TINY = 1e-300


def rolling_rates(
    body: Body,
    l: Scalar,  # noqa: E741
    head_velocity: tuple[Scalar, Scalar, Scalar],
    rate_of: Callable[[int, Scalar], Scalar],
    first: int = 1,
) -> list[Scalar]:
    """Joint rates with which every wheel rolls, but for joints that turn otherwise.

    Solves (7) for u by forward substitution: row k of ``A-tilde' w-dot = B-tilde' u`` reads
    ``nrm(theta_k) . dW_k/dt = 0``.

    Args:
        body: The robot's body.
        l: Half a link's length [m].
        head_velocity: The head's velocity in its own frame and its turning rate [m/s, m/s, rad/s].
        rate_of: The rate of joint k, from k and the rate with which its wheel rolls [rad/s].
        first: The first joint that can move at all; the rates before it are 0.

    Returns:
        u, n values [rad/s].
    """
    vx, vy, turning = head_velocity
    # Velocities in l/s: ``step`` is that of a link's rear end against its front end.
    step = 2.0 * turning
    vx, vy = vx / l, vy / l - step  # of J_1
    rates: list[Scalar] = [0.0] * (first - 1)
    for k in range(first, body.n_joints + 1):
        cosine, sine = body.directions[k]
        rolling = vy * cosine - vx * sine - 0.5 * step
        rates.append(rate_of(k, rolling))
        step = step + 2.0 * rates[-1]
        vx, vy = vx + step * sine, vy - step * cosine
    return rates


def limit_margin(phi: Sequence[Scalar], rear: Sequence[Bool], p: SnakeParams) -> Scalar:
    """Phi of (26) [rad]: least distance to the joint limit behind the SCP; infinite at the tail."""
    largest: Scalar = 0.0
    for angle, behind in zip(phi, rear, strict=True):
        largest = maximum(select(behind, absolute(angle), 0.0), largest)
    return select(rear[-1], p.phi_limit - largest, math.inf)  # the last joint, or none


def tracking_gain(margin: Scalar, p: SnakeParams) -> Scalar:
    """k_t of (28): 1 far from the joint limits, 0 at and beyond them."""
    _, cosine = sin_cos(math.pi / p.k_0 * maximum(minimum(margin, p.k_0), 0.0))
    return 0.5 * (1.0 - cosine)


def redundancy_gain(t: float, p: SnakeParams) -> float:
    """k_eta of (16) at time ``t`` [s] inside the interval: 0 at both its ends."""
    return (1.0 - math.cos(2.0 * math.pi * t / p.delta_t)) * p.k_eta


def reference(start: Scalar, target: Scalar, time_in_phase: Scalar, p: SnakeParams) -> Scalar:
    """Reference of the SCP [rad]: a cycloidal cam from ``start`` to ``target``, section III-B."""
    x = minimum(time_in_phase / p.cam_time, 1.0)
    sine, _ = sin_cos(2.0 * math.pi * x)
    return start + (target - start) * (x - sine / (2.0 * math.pi))


def null_space_input(
    body: Body,
    l: Scalar,  # noqa: E741
    columns: Sequence[Sequence[Bool]],
    gradient: Sequence[Scalar],
) -> list[Scalar]:
    """``(I - B~^+ B~) eta`` of (11): the gradient's projection on the null space of B-tilde.

    The null space is spanned by the columns of the inverse of ``B-tilde'`` that belong to the lifted
    rear wheels: turn that joint, and let every wheel behind it roll. They are made orthogonal by
    Gram-Schmidt, from the rearmost, which has the fewest entries.

    Args:
        body: The robot's body.
        l: Half a link's length [m].
        columns: For each lifted rear wheel, from the front: a one-hot mark of its joint; no mark at
            all in columns that are not used.
        gradient: eta of (14), n values.

    Returns:
        The projection, n values.
    """
    basis: list[tuple[int, list[Scalar], Scalar]] = []  # first joint, vector from it on, |.|^2
    result: list[Scalar] = [0.0] * len(gradient)
    for c in reversed(range(len(columns))):
        first = c + 2  # the SCP is joint 1 or later, and c lifted wheels lie between
        vector = _null_space_column(body, l, columns[c], first)
        for other_first, other, squared_norm in basis:
            offset = other_first - first
            overlap = dot(vector[offset:], other) / squared_norm
            for k, value in enumerate(other):
                vector[offset + k] = vector[offset + k] - overlap * value
        squared_norm = maximum(dot(vector, vector), _TINY)  # an unused column is 0, and stays so
        basis.append((first, vector, squared_norm))
        share = dot(vector, gradient[first - 1 :]) / squared_norm
        for k, value in enumerate(vector, start=first - 1):
            result[k] = result[k] + share * value
    return result


def _null_space_column(
    body: Body,
    l: Scalar,  # noqa: E741
    lifted: Sequence[Bool],
    first: int,
) -> list[Scalar]:
    """Rates from joint ``first`` on: the marked joint turns at 1 rad/s, every wheel behind it rolls."""
    marks = [select(is_lifted, 1.0, 0.0) for is_lifted in lifted]

    def rate_of(k: int, rolling: Scalar) -> Scalar:
        return rolling + marks[k - 1]  # up to the marked joint, rolling is 0: nothing moves there

    return rolling_rates(body, l, (0.0, 0.0, 0.0), rate_of, first)[first - 1 :]


def input_scale(u: Sequence[Scalar], p: SnakeParams) -> Scalar:
    """k_u of (30): scales the input down to the joint speed limit without bending its direction."""
    fastest = absolute(u[0])
    for rate in u[1:]:
        fastest = maximum(absolute(rate), fastest)
    return p.u_limit / maximum(fastest, p.u_limit)


def limited_input(
    body: Body,
    phi: Sequence[Scalar],
    w: Sequence[Scalar],
    scp_reference: Scalar,
    scp: Sequence[Bool],
    rear: Sequence[Bool],
    columns: Sequence[Sequence[Bool]],
    gradient: Sequence[Scalar],
    k_eta: Scalar,
    p: SnakeParams,
) -> tuple[list[Scalar], list[Scalar]]:
    """The joint input (29) and the velocity of the head that goes with it.

    Args:
        body: The robot's body at ``phi``.
        phi: Joint angles, n values [rad].
        w: Head pose, 3 values [m, m, rad].
        scp_reference: What the SCP's angle should be now [rad].
        scp: One-hot mark of the SCP's joint, n values.
        rear: Marks of the joints behind the SCP, n values.
        columns: One-hot marks of the lifted rear wheels, see :func:`null_space_input`.
        gradient: eta of (14), n values.
        k_eta: The redundant input's gain (16).
        p: The constants.

    Returns:
        u (n values) [rad/s] and dw/dt (3 values) [m/s, m/s, rad/s].
    """
    k_t = tracking_gain(limit_margin(phi, rear, p), p)
    # (10) with (17) and (27): the wanted velocity is -k_t K' (w-tilde - w-tilde_d).
    vx, vy, turning = (-(k_t * p.gains[axis]) * (w[axis] - p.w_d[axis]) for axis in range(3))
    scp_angle = total([select(mark, angle, 0.0) for mark, angle in zip(scp, phi, strict=True)])
    scp_rate = -(k_t * p.gains[3]) * (scp_angle - scp_reference)
    sine, cosine = sin_cos(w[2])
    head_velocity = (vx * cosine + vy * sine, vy * cosine - vx * sine, turning)

    def tracking_rate(k: int, rolling: Scalar) -> Scalar:
        return select(scp[k - 1], scp_rate, rolling)

    u_t = rolling_rates(body, p.l, head_velocity, tracking_rate)
    u_ker = null_space_input(body, p.l, columns, gradient)
    u = [tracking - k_eta * ker for tracking, ker in zip(u_t, u_ker, strict=True)]  # (9), (11)
    k_u = input_scale(u, p)
    return [k_u * rate for rate in u], [k_u * vx, k_u * vy, k_u * turning]  # (29)
