"""What an agent sees: a flat, normalised vector, for one state or many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.params import SnakeParams
from snake_env.state import FloatArray, StateBatch

HEAD_SCALE_M = 0.1
HEAD_SCALE_RAD = 0.5
TIME_SCALE_S = 30.0


def observation_rows(n_joints: int) -> list[tuple[str, int]]:
    """Names of the observation's blocks and how many values each has, in order."""
    n = n_joints
    return [
        ("phi", n),
        ("target", n),
        ("error", n),
        ("phase", n + 1),
        ("scp_error", 1),
        ("ref_start", 1),
        ("phase_time", 1),
        ("head_error", 3),
        ("link_direction", 2 * n),
        ("link_centre", 2 * n),
        ("centre_of_gravity", 2),
    ]


def observation_size(n_joints: int) -> int:
    """Values in an observation."""
    return sum(size for _, size in observation_rows(n_joints))


def observe(states: StateBatch, params: SnakeParams) -> NDArray[np.float32]:
    """Observations of many states, each value within [-1, 1].

    Args:
        states: N states.
        params: The constants.

    Returns:
        Shape (N, observation_size), float32, freshly allocated. The rows are described in
        :class:`snake_env.env.SnakeModeSelectionEnv`.
    """
    n = params.n_joints
    count = len(states)
    lanes = np.arange(count)
    limit = params.phi_limit
    scp = np.minimum(states.phase, n) - 1
    error = states.target - states.phi
    phase = np.zeros((count, n + 1))
    phase[lanes, states.phase - 1] = 1.0
    heading = np.cumsum(states.phi, axis=1)
    direction: FloatArray = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    # Head's frame, link lengths: joint J_k is one link behind J_{k-1}; link 0 points along +x.
    behind = np.concatenate([np.tile([[[1.0, 0.0]]], (count, 1, 1)), direction], axis=1)
    joints = -np.cumsum(behind, axis=1)
    centres = joints[:, :-1] - 0.5 * direction
    gravity = (centres.sum(axis=1) - [0.5, 0.0]) / (n + 1)
    head_scale = [HEAD_SCALE_M, HEAD_SCALE_M, HEAD_SCALE_RAD]
    blocks = [
        states.phi / limit,
        states.target / limit,
        error / (2.0 * limit),
        phase,
        (error[lanes, scp] / (2.0 * limit))[:, None],
        (states.ref_start / limit)[:, None],
        (states.phase_time / TIME_SCALE_S)[:, None],
        (states.w - params.w_d) / head_scale,
        direction.reshape(count, -1),
        (centres / (n + 1)).reshape(count, -1),
        gravity / (n + 1),
    ]
    clipped: NDArray[np.float32] = np.clip(np.concatenate(blocks, axis=1), -1.0, 1.0).astype(
        np.float32
    )
    return clipped
