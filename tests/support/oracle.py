"""Literal NumPy transcription of the paper's equations: slow, explicit, the oracle of the tests.

Shares no code with the package. Joints, wheels and phases are numbered from 1 as in the paper;
arrays from 0, so joint or wheel k is at index k - 1 and link k (0..n) at index k. Numbers in
parentheses are the equations of M. Tanaka and K. Tanaka, IEEE TCST 25(4), 2017. `w` is
(x0, y0, theta0), shape (3,) [m, m, rad]; `phi` the joint angles, shape (n,) [rad]; `lifted`, shape
(n,), marks every lifted wheel, the SCP's included; `c` the constants.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Constants:
    """Table I and the constants that the paper leaves open (preset `paper`)."""

    n: int = 8  # yaw joints
    l: float = 0.091  # half a link's length [m]  # noqa: E741
    delta_t: float = 3.0  # switching period of the mode [s], (4)
    dt: float = 0.02  # sampling time [s]
    cam_time: float = 1.5  # duration of the cam curve [s], section III-B
    c_phi: float = math.pi / 4  # activation angle of V_L [rad], (19)
    d_0: float = 0.27  # activation distance of V_c [m], (19)
    a_l: float = 2.1  # weights of (19) and (24)
    a_c: float = 670.0
    a_s: float = 2e-3
    a_scp: float = 1e-4
    w_d: tuple[float, float, float] = (0.0, 0.0, math.pi)  # desired w [m, m, rad]
    k_0: float = math.pi / 4  # activation angle of (28) [rad]
    k_eta: float = 2.0  # k'_eta of (16)
    gains: tuple[float, float, float, float] = (1.0, 1.0, 0.5, 2.0)  # diagonal of K' (27) [1/s]
    phi_limit: float = math.pi / 2  # joint limit [rad], (23)
    u_limit: float = math.pi / 4  # input limit [rad/s], (30)
    epsilon_p: float = 0.05  # convergence of the SCP [rad], (18)
    track: float = 0.10  # between the left and right wheel of an axle [m]
    head_contact: bool = True  # link 0 rests on the ground; False in `narrow`
    limit_tolerance: float = 1e-6  # tolerance of (23) [rad]
    det_floor: float = 1e-6  # floor of the determinant in V_s


@dataclass(frozen=True)
class Interval:
    """One interval under one mode; up to and including the violation if there is one."""

    phi: Array  # last joint angles, shape (n,) [rad]
    w: Array  # last head position and heading, shape (3,) [m, m, rad]
    cost: float  # integral of V so far
    j: float  # J of (24), inf if infeasible
    feasible: bool
    violation: str  # "", "stability" (22) or "joint_limit" (23)
    d_min: float  # smallest distance over the interval [m]
    max_abs_phi: float  # largest |phi_i| over the interval [rad]


def headings(w: Array, phi: Array) -> Array:
    """Return theta_0..theta_n, shape (n+1,) [rad]; theta_k = theta_0 + phi_1 + ... + phi_k."""
    theta: Array = w[2] + np.concatenate(([0.0], np.cumsum(phi)))
    return theta


def joints_and_centres(w: Array, phi: Array, c: Constants) -> tuple[Array, Array, Array]:
    """Return the joints J_1..J_n (n, 2), link centres W_0..W_n (n+1, 2) and tail tip (2,) [m]."""
    theta = headings(w, phi)
    front = np.array([w[0], w[1]])  # front end of link k
    joints, centres = [], []
    for k in range(c.n + 1):
        e = np.array([math.cos(theta[k]), math.sin(theta[k])])
        centres.append(front - c.l * e)
        front = front - 2 * c.l * e
        joints.append(front)
    return np.array(joints[:-1]), np.array(centres), joints[-1]


def matrix_a(w: Array, phi: Array, c: Constants) -> Array:
    """Return A of (1), shape (n, 3): row k is nrm(theta_k) . dW_k/dw."""
    theta = headings(w, phi)
    a = np.zeros((c.n, 3))
    for k in range(1, c.n + 1):
        middle = sum(math.cos(theta[k] - theta[j]) for j in range(1, k))
        a[k - 1, 0] = -math.sin(theta[k])
        a[k - 1, 1] = math.cos(theta[k])
        a[k - 1, 2] = -(2 * c.l * math.cos(theta[k] - theta[0]) + 2 * c.l * middle + c.l)
    return a


def matrices(w: Array, phi: Array, c: Constants) -> tuple[Array, Array]:
    """Return A (n, 3) and B (n, n) of (1), A wdot = B u."""
    theta = headings(w, phi)
    b = np.zeros((c.n, c.n))
    for k in range(1, c.n + 1):
        for i in range(1, k + 1):
            chain = sum(math.cos(theta[k] - theta[j]) for j in range(i, k))
            b[k - 1, i - 1] = c.l + 2 * c.l * chain
    return matrix_a(w, phi, c), b


def squared_distances(w: Array, phi: Array, c: Constants) -> dict[tuple[int, int], float]:
    """Return d_{i,j}^2 [m^2] of (19) for all pairs 1 <= j <= i-3, keyed by (i, j)."""
    _, points, tail = joints_and_centres(w, phi, c)
    points[0], points[c.n] = w[:2], tail  # p_0 head tip, p_i link centre, p_n tail tip
    pairs = [(i, j) for i in range(1, c.n + 1) for j in range(1, i - 2)]
    return {(i, j): float(np.sum((points[i] - points[j]) ** 2)) for i, j in pairs}


def minimum_distance(w: Array, phi: Array, c: Constants) -> float:
    """Return d_min [m] over all pairs 1 <= j <= i-3."""
    return math.sqrt(min(squared_distances(w, phi, c).values()))


def determinant(phi: Array, lifted: Bools, c: Constants) -> float:
    """Return det(A-bar^T A-bar) of (19); it does not depend on w."""
    a_bar = matrix_a(np.zeros(3), phi, c)[~lifted]  # (2)
    return float(np.linalg.det(a_bar.T @ a_bar))


def f(x: float, y: float) -> float:
    """Return the penalty (20)."""
    return (y - x) ** 3 if x < y else 0.0


def potential(phi: Array, lifted: Bools, phase: int, c: Constants) -> float:
    """Return V of (19)."""
    rear = range(phase + 1, c.n + 1)
    squared = squared_distances(np.zeros(3), phi, c)
    v_l = sum(f(c.c_phi, abs(phi[i - 1])) for i in rear)
    v_c = sum(f(math.sqrt(d2), c.d_0) for (i, _), d2 in squared.items() if i in rear)
    v_s = 1.0 / max(determinant(phi, lifted, c), c.det_floor)
    return float(c.a_l * v_l + c.a_c * v_c + c.a_s * v_s)


def difference(function: Callable[[Array], Array], phi: Array) -> Array:
    """Return d function_k / d phi_i, shape (n, m), by sixth-order central differences."""
    step = 2e-3  # truncation about step^6, rounding about 1e-16 / step
    rows = []
    for direction in np.eye(len(phi)) * step:
        row = sum(
            weight * (function(phi + m * direction) - function(phi - m * direction))
            for m, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
        )
        rows.append(row / step)
    return np.array(rows)


def potential_gradient(phi: Array, lifted: Bools, phase: int, c: Constants) -> Array:
    """Return eta = dV/dphi of (14), shape (n,).

    Only d^2 and the determinant are differenced, as they are trigonometric polynomials of phi;
    (20), the square root and the reciprocal follow by the chain rule. Differences of V itself
    would lose accuracy across the kinks of (20) and near singular shapes.
    """
    zero = np.zeros(3)
    eta = np.zeros(c.n)
    for i in range(phase + 1, c.n + 1):  # V_L
        excess = max(abs(phi[i - 1]) - c.c_phi, 0.0)
        eta[i - 1] = c.a_l * 3 * excess**2 * np.sign(phi[i - 1])

    squared = squared_distances(zero, phi, c)
    slope = difference(lambda x: np.array(list(squared_distances(zero, x, c).values())), phi)
    for column, ((i, _), d2) in enumerate(squared.items()):  # V_c: df/d(d^2) = -3 (d_0-d)^2 / 2d
        d = math.sqrt(d2)
        if i > phase and 0.0 < d < c.d_0:
            eta += c.a_c * -3 * (c.d_0 - d) ** 2 / (2 * d) * slope[:, column]

    det = determinant(phi, lifted, c)
    if det > c.det_floor:  # V_s; constant below the floor
        slope = difference(lambda x: np.array([determinant(x, lifted, c)]), phi)
        eta += c.a_s * -1.0 / det**2 * slope[:, 0]
    return eta


def reference(target_scp: float, ref_start: float, time_in_phase: float, c: Constants) -> float:
    """Return the SCP's desired angle [rad]: a cycloidal cam from ref_start, then the target."""
    x = min(max(time_in_phase / c.cam_time, 0.0), 1.0)
    return ref_start + (target_scp - ref_start) * (x - math.sin(2 * math.pi * x) / (2 * math.pi))


def tracking_gain(phi: Array, phase: int, c: Constants) -> float:
    """Return k_t of (28); 1 in the last phase, which has no rear joints."""
    margin = min((c.phi_limit - abs(phi[i]) for i in range(phase, c.n)), default=math.inf)  # (26)
    if margin <= 0.0:
        return 0.0
    return 0.5 * (1 - math.cos(math.pi / c.k_0 * margin)) if margin < c.k_0 else 1.0


def unlimited_input(
    w: Array, phi: Array, target: Array, phase: int, ref_start: float, phase_time: float,
    lifted: Bools, t: float, c: Constants,
) -> tuple[Array, Array]:  # fmt: skip
    """Return u_t + u_ker of (9), shape (n,) [rad/s], and the head velocity of (13), shape (3,)."""
    scp = phase - 1
    a, b = matrices(w, phi, c)
    c_row = np.zeros((1, c.n))  # C of (6), m = 1
    c_row[0, scp] = 1.0
    others = np.arange(c.n) != scp
    a_prime = np.block([[a[others], np.zeros((c.n - 1, 1))], [np.zeros((1, 3)), np.eye(1)]])
    b_prime = np.vstack([b[others], c_row])  # (7)
    b_tilde = np.vstack([b[~lifted], c_row])  # (2), (6)

    desired = np.append(c.w_d, reference(target[scp], ref_start, phase_time + t, c))
    error = np.append(w, phi[scp]) - desired  # e of (12); the heading is not wrapped
    gain = tracking_gain(phi, phase, c) * np.diag(c.gains)  # (27)
    velocity = np.zeros(4) - gain @ error  # (17)
    u_t = np.linalg.solve(b_prime, a_prime @ velocity)  # (10)

    k_eta = (1 - math.cos(2 * math.pi * t / c.delta_t)) * c.k_eta  # (16)
    null = np.eye(c.n) - np.linalg.pinv(b_tilde) @ b_tilde
    u_ker = -k_eta * null @ potential_gradient(phi, lifted, phase, c)  # (11)
    return u_t + u_ker, velocity[:3]


def limiting_factor(u: Array, c: Constants) -> float:
    """Return k_u of (30) for the unlimited input u, shape (n,) [rad/s]."""
    largest = float(np.max(np.abs(u)))
    return c.u_limit / largest if c.u_limit < largest else 1.0


def joint_input(
    w: Array, phi: Array, target: Array, phase: int, ref_start: float, phase_time: float,
    lifted: Bools, t: float, c: Constants,
) -> Array:  # fmt: skip
    """Return the joint input of (29), shape (n,) [rad/s].

    Args:
        w: Head position and heading, shape (3,) [m, m, rad].
        phi: Joint angles, shape (n,) [rad].
        target: Target angles, shape (n,) [rad].
        phase: Number of the SCP, 1..n.
        ref_start: The SCP's angle when the phase began [rad].
        phase_time: Time since the phase began, at the interval's start t_k [s].
        lifted: All lifted wheels, shape (n,).
        t: Time inside the interval [s].
        c: Constants.
    """
    u, _ = unlimited_input(w, phi, target, phase, ref_start, phase_time, lifted, t, c)
    return limiting_factor(u, c) * u


def cross(a: Array, b: Array, p: Array) -> float:
    """Return twice the signed area of the triangle a, b, p: positive if p is left of a -> b."""
    return float((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))


def convex_hull(points: Array) -> list[Array]:
    """Return the hull's corners, counter-clockwise, of points (k, 2), by monotone chain."""
    ordered = list(np.unique(points, axis=0))
    hull: list[Array] = []
    for half in (ordered, ordered[::-1]):
        chain: list[Array] = []
        for p in half:
            while len(chain) >= 2 and cross(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        hull += chain[:-1]
    return hull


def stability_margin(w: Array, phi: Array, lifted: Bools, c: Constants) -> float:
    """Return the distance [m] of the centre of gravity to the hull's nearest side line.

    Positive inside the hull, zero on its edge, negative outside, -inf if the hull has no area.
    """
    theta = headings(w, phi)
    _, centres, _ = joints_and_centres(w, phi, c)
    contacts = [centres[0]] if c.head_contact else []
    for k in range(1, c.n + 1):
        if not lifted[k - 1]:
            side = c.track / 2 * np.array([-math.sin(theta[k]), math.cos(theta[k])])
            contacts += [centres[k] + side, centres[k] - side]
    hull = convex_hull(np.array(contacts))
    if len(hull) < 3:
        return -math.inf
    gravity = np.mean(centres, axis=0)
    sides = zip(hull, hull[1:] + hull[:1], strict=True)
    return min(cross(a, b, gravity) / math.dist(a, b) for a, b in sides)


def stable(w: Array, phi: Array, lifted: Bools, c: Constants) -> bool:
    """Return (22): the centre of gravity is strictly inside the hull of the contacts."""
    return stability_margin(w, phi, lifted, c) > 0.0


def interval(
    w: Array, phi: Array, target: Array, phase: int, ref_start: float, phase_time: float,
    lifted: Bools, c: Constants,
) -> Interval:  # fmt: skip
    """Integrate one interval and return its outcome; arguments as in `joint_input`."""
    start, w, phi = phi, w.copy(), phi.copy()
    cost, violation = 0.0, ""
    d_min, max_abs_phi = minimum_distance(w, phi, c), float(np.max(np.abs(phi)))
    for s in range(round(c.delta_t / c.dt)):
        t = s * c.dt
        if not stable(w, phi, lifted, c):  # (22)
            violation = "stability"
            break
        u, w_dot = unlimited_input(w, phi, target, phase, ref_start, phase_time, lifted, t, c)
        k_u = limiting_factor(u, c)
        cost += potential(phi, lifted, phase, c) * c.dt
        phi = phi + c.dt * k_u * u  # (29)
        w = w + c.dt * k_u * w_dot
        max_abs_phi = max(max_abs_phi, float(np.max(np.abs(phi))))
        if np.any(np.abs(phi) > c.phi_limit + c.limit_tolerance):  # (23)
            violation = "joint_limit"
            break
        d_min = min(d_min, minimum_distance(w, phi, c))
    if not violation and not stable(w, phi, lifted, c):  # (22) at t_{k+1}
        violation = "stability"
    rotation = abs(float(phi[phase - 1] - start[phase - 1]))
    j = math.inf if violation else c.a_scp / max(rotation, 1e-12) + cost  # (24), (25)
    return Interval(phi, w, cost, j, not violation, violation, d_min, max_abs_phi)


def valid_modes(phase: int, n: int) -> list[Bools]:
    """Return the phase's modes, each (n,): by number of lifted rear wheels, then wheel numbers."""
    modes = []
    for count in range(n - phase + 1):
        for wheels in combinations(range(phase + 1, n + 1), count):
            lifted = np.zeros(n, dtype=np.bool_)
            lifted[[phase - 1, *(k - 1 for k in wheels)]] = True
            if np.sum(~lifted) >= 3:
                modes.append(lifted)
    return modes
