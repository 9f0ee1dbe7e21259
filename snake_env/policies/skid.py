"""The naive way, Fig. 7(a): all joints turn at once and the wheels skid, dragging the head along."""

from __future__ import annotations

import numpy as np

from snake_env.equations.kinematics import locate
from snake_env.kernel.distance import d_min
from snake_env.params import SnakeParams
from snake_env.sim.episode import EpisodeSummary
from snake_env.state import FloatArray, SnakeState


def constraint_matrices(phi: FloatArray, params: SnakeParams) -> tuple[FloatArray, FloatArray]:
    """A (n, 3) and B (n, n) of (1) with all wheels on the ground, velocities in the head's frame."""
    body = locate(phi.tolist(), params.l)
    directions = np.array(body.directions[1:], dtype=np.float64)
    joints = np.array(body.joints[1:], dtype=np.float64)
    centres = np.array(body.centres[1:], dtype=np.float64)
    normals = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    a = np.column_stack([normals, (directions * centres).sum(axis=1)])
    b = -np.tril(directions @ (-joints.T) + (directions * centres).sum(axis=1)[:, None])
    return a, b


def skid(state: SnakeState, params: SnakeParams) -> tuple[EpisodeSummary, FloatArray]:
    """Turns every joint straight to its target at up to u_limit; the head follows as it must.

    The wheels can't all roll, so the head moves with the least squares of their sideways slip:
    ``w-dot = argmin |A w-dot - B u|``.

    Args:
        state: Where it begins.
        params: The constants.

    Returns:
        The episode's figures (head errors over the whole motion), and the head's path, (K + 1, 3)
        [m, m, rad].
    """
    phi, w = state.phi.copy(), state.w.copy()
    path = [w.copy()]
    closest = d_min(phi, params.l)
    largest = float(np.abs(phi).max())
    reached = bool(np.abs(state.target - phi).max() < 1e-9)
    while not reached and (len(path) - 1) * params.dt < params.horizon_s:
        u = np.clip((state.target - phi) / params.dt, -params.u_limit, params.u_limit)
        a, b = constraint_matrices(phi, params)
        forward, sideways, turning = np.linalg.lstsq(a, b @ u, rcond=None)[0]
        cosine, sine = np.cos(w[2]), np.sin(w[2])
        velocity = (cosine * forward - sine * sideways, sine * forward + cosine * sideways, turning)
        phi = phi + params.dt * u
        w = w + params.dt * np.array(velocity)
        path.append(w.copy())
        closest = min(closest, d_min(phi, params.l))
        largest = max(largest, float(np.abs(phi).max()))
        reached = bool(np.abs(state.target - phi).max() < 1e-9)
    error = np.array(path) - params.w_d
    duration = (len(path) - 1) * params.dt
    outcome = "collision" if closest < params.d_touch else "success" if reached else "horizon"
    summary = EpisodeSummary(
        outcome=outcome,
        intervals=int(np.ceil(duration / params.delta_t)),
        time_s=duration,
        shape_error_rad=float(np.abs(state.target - phi).max()),
        phase=params.n_joints + 1 if outcome == "success" else state.phase,
        cost_integral=float("nan"),
        d_min=closest,
        max_abs_phi=largest,
        head_error_m=float(np.hypot(error[:, 0], error[:, 1]).max()),
        head_error_rad=float(np.abs(error[:, 2]).max()),
    )
    return summary, np.array(path)
