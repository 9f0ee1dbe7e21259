"""What an agent sees: a flat, normalised vector, for one state or many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.state import FloatArray, StateBatch

HEAD_SCALE_M = 0.1
HEAD_SCALE_RAD = 0.5
TIME_SCALE_S = 30.0
TURN_SCALE_RAD = 0.5
SUPPORT_DIRECTIONS = 8


def observation_rows(n_joints: int) -> list[tuple[str, int]]:
    """Names of the observation's blocks and how many values each has, in order."""
    n = n_joints
    return [
        ("phi", n),
        ("target", n),
        ("error", n),
        ("limit_margin", n),
        ("phase", n + 1),
        ("scp_error", 1),
        ("ref_start", 1),
        ("cam_progress", 1),
        ("phase_time", 1),
        ("last_lifted", n),
        ("last_turn", 1),
        ("head_error", 3),
        ("link_direction", 2 * n),
        ("link_centre", 2 * n),
        ("centre_of_gravity", 2),
        ("support_margin", SUPPORT_DIRECTIONS),
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
    n, count = params.n_joints, len(states)
    lanes = np.arange(count)
    limit = params.phi_limit
    scp = np.minimum(states.phase, n) - 1
    error = states.target - states.phi
    phase = np.zeros((count, n + 1))
    phase[lanes, states.phase - 1] = 1.0
    last_lifted = np.where(
        states.last_mode[:, None] >= 0, mode_table(n).lifted[states.last_mode], False
    )
    # Head's frame, in link lengths: joint J_k is one link behind J_{k-1}; link 0 points along +x.
    heading = np.cumsum(states.phi, axis=1)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    front = np.concatenate([np.tile([[[1.0, 0.0]]], (count, 1, 1)), direction[:, :-1]], axis=1)
    centres = -np.cumsum(front, axis=1) - 0.5 * direction
    gravity = (centres.sum(axis=1) - [0.5, 0.0]) / (n + 1)
    observation = np.concatenate(
        [
            states.phi / limit,
            states.target / limit,
            error / (2.0 * limit),
            1.0 - np.abs(states.phi) / limit,
            phase,
            (error[lanes, scp] / (2.0 * limit))[:, None],
            (states.ref_start / limit)[:, None],
            (states.phase_time / params.cam_time)[:, None],
            (states.phase_time / TIME_SCALE_S)[:, None],
            last_lifted,
            (states.last_turn / TURN_SCALE_RAD)[:, None],
            (states.w - params.w_d) / [HEAD_SCALE_M, HEAD_SCALE_M, HEAD_SCALE_RAD],
            direction.reshape(count, -1),
            (centres / (n + 1)).reshape(count, -1),
            gravity / (n + 1),
            _support_margins(direction, centres, gravity, scp, params),
        ],
        axis=1,
    )
    clipped: NDArray[np.float32] = np.clip(observation, -1.0, 1.0).astype(np.float32)
    return clipped


def _support_margins(
    direction: FloatArray,
    centres: FloatArray,
    gravity: FloatArray,
    scp: NDArray[np.int64],
    params: SnakeParams,
) -> FloatArray:
    """How far the support reaches beyond the centre of gravity in evenly spread directions.

    The support is that of the mode that lifts no rear wheel: the largest there is. The robot is stable
    in that mode only if every value is positive. Shape (N, SUPPORT_DIRECTIONS), in link lengths.
    """
    angles = np.arange(SUPPORT_DIRECTIONS) * (2.0 * np.pi / SUPPORT_DIRECTIONS)
    towards = np.stack([np.cos(angles), np.sin(angles)])
    half_track = 0.25 * params.track / params.l
    reach = centres @ towards
    sideways = np.abs(direction[:, :, ::-1] * [-1.0, 1.0] @ towards) * half_track
    reach = reach + sideways
    reach[np.arange(len(scp)), scp] = -np.inf
    support: FloatArray = reach.max(axis=1)
    if params.head_contact:
        support = np.maximum(support, np.array([-0.5, 0.0]) @ towards)
    margins: FloatArray = support - gravity @ towards
    return margins
