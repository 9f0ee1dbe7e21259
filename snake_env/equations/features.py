"""What an agent sees of a state, on generic scalars: the values of the observation."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

from snake_env.equations.kinematics import Body, Point, centre_of_gravity, locate
from snake_env.equations.scalars import Bool, Scalar, absolute, maximum, select, sin_cos
from snake_env.params import SnakeParams

HEAD_SCALES = (0.1, 0.1, 0.5)  # [m, m, rad]
TIME_SCALE_S = 30.0
TURN_SCALE_RAD = 0.5
SUPPORT_DIRECTIONS = 8


def features(
    p: SnakeParams,
    phi: Sequence[Scalar],
    target: Sequence[Scalar],
    w: Sequence[Scalar],
    phase: Scalar,
    phase_time: Scalar,
    ref_start: Scalar,
    last_turn: Scalar,
    last_lifted: Sequence[Scalar],
) -> dict[str, list[Scalar]]:
    """The values of each block of the observation, clipped to [-1, 1].

    The blocks are described in :class:`snake_env.envs.env.SnakeModeSelectionEnv`.

    Args:
        p: The constants.
        phi: Joint angles, n values [rad].
        target: Target joint angles, n values [rad].
        w: Head pose, 3 values [m, m, rad].
        phase: The SCP's number; n + 1: the target is reached.
        phase_time: Time since the phase began [s].
        ref_start: The SCP's angle when the phase began [rad].
        last_turn: How far the SCP of the last interval turned in it [rad].
        last_lifted: 1 for each rear wheel that the last mode lifted, else 0: n values.
    """
    n, limit = len(phi), p.phi_limit
    body = locate(phi, 0.5)  # in link lengths
    gravity = centre_of_gravity(body)
    scp: list[Bool] = [phase == float(k) for k in range(1, n)]
    scp.append(phase >= float(n))  # the last SCP remains it once the target is reached
    error = [(goal - angle) / (2.0 * limit) for angle, goal in zip(phi, target, strict=True)]
    scp_error = error[-1]
    for is_scp, value in zip(scp[:-1], error[:-1], strict=True):
        scp_error = select(is_scp, value, scp_error)
    blocks: dict[str, list[Scalar]] = {
        "phi": [angle / limit for angle in phi],
        "target": [angle / limit for angle in target],
        "error": error,
        "limit_margin": [1.0 - absolute(angle) / limit for angle in phi],
        "phase": [select(phase == float(k), 1.0, 0.0) for k in range(1, n + 2)],
        "scp_error": [scp_error],
        "ref_start": [ref_start / limit],
        "cam_progress": [phase_time / p.cam_time],
        "phase_time": [phase_time / TIME_SCALE_S],
        "last_lifted": list(last_lifted),
        "last_turn": [last_turn / TURN_SCALE_RAD],
        "head_error": [
            (now - wanted) / scale for now, wanted, scale in zip(w, p.w_d, HEAD_SCALES, strict=True)
        ],
        "link_direction": [x for direction in body.directions[1:] for x in direction],
        "link_centre": [x / (n + 1.0) for centre in body.centres[1:] for x in centre],
        "centre_of_gravity": [x / (n + 1.0) for x in gravity],
        "support_margin": _support_margins(body, gravity, scp, p),
    }
    return {name: [_clipped(value) for value in values] for name, values in blocks.items()}


def _clipped(x: Scalar) -> Scalar:
    return select(x > 1.0, 1.0, select(x < -1.0, -1.0, x))


def _support_margins(
    body: Body, gravity: Point, scp: Sequence[Bool], p: SnakeParams
) -> list[Scalar]:
    """How far the support reaches beyond the centre of gravity in evenly spread directions.

    The support is that of the mode that lifts no rear wheel: the largest there is. The robot is stable
    in that mode only if every value is positive. In the body's unit: link lengths.
    """
    half_track = 0.25 * p.track / p.l
    wheels = list(zip(scp, body.directions[1:], body.centres[1:], strict=True))
    margins: list[Scalar] = []
    for step in range(SUPPORT_DIRECTIONS):
        ty, tx = sin_cos(step * (2.0 * math.pi / SUPPORT_DIRECTIONS))
        reach: list[Scalar] = [body.centres[0][0] * tx] if p.head_contact else []
        for is_scp, (cosine, sine), (x, y) in wheels:
            sideways = absolute(cosine * ty - sine * tx) * half_track
            reach.append(select(is_scp, -math.inf, x * tx + y * ty + sideways))
        support = functools.reduce(maximum, reach)
        margins.append(support - (gravity[0] * tx + gravity[1] * ty))
    return margins
