"""The motion of an episode as the page replays it: compact, and decoded by ``robot.js``.

The page computes where the links are from the joint angles, so that these are all it needs: one frame
every :data:`FRAME_EVERY_S`, each angle a multiple of :data:`QUANTUM` in two bytes.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluate.protocol import Row, chooses_modes
from evaluate.replay import replay
from snake_env.params import SnakeParams
from snake_env.policies.skid import skid
from snake_env.sim.episode import STILL
from snake_env.state import FloatArray, SnakeState

FRAME_EVERY_S = 0.1
QUANTUM = 1e-4
"""Joint angles are rounded to this [rad]: phi_limit < pi leaves room in 16 bits."""


@dataclass(frozen=True, eq=False)
class Motion:
    """An episode at every sub-step.

    Attributes:
        phi: Joint angles, shape (K + 1, n) [rad].
        w: Head pose, shape (K + 1, 3) [m, m, rad].
        phases: Phase of each interval.
        lifted: Wheels in the air in each interval, shape (intervals, n).
    """

    phi: FloatArray
    w: FloatArray
    phases: list[int]
    lifted: NDArray[np.bool_]


def motion_of(row: Row, state: SnakeState, params: SnakeParams) -> Motion:
    """The motion of the episode of a row.

    Args:
        row: The episode.
        state: Where it begins.
        params: The constants.
    """
    if not chooses_modes(row["policy"]):
        return _skidding(state, params)
    played = replay(row, state, params)
    end = played.states[-1]
    intervals = range(len(played.modes))
    return Motion(
        phi=np.concatenate([*(motion.phi[:-1] for motion in played.motions), end.phi[None]]),
        w=np.concatenate([*(motion.w[:-1] for motion in played.motions), end.w[None]]),
        phases=[played.states[k].phase for k in intervals],
        lifted=np.array([played.lifted(k, params) for k in intervals], dtype=np.bool_).reshape(
            -1, params.n_joints
        ),
    )


def until_still(motion: Motion, params: SnakeParams) -> Motion:
    """What there is to see: the motion up to the first interval after which nothing moves any more."""
    steps = params.n_steps
    turned = [
        np.abs(motion.phi[min((k + 1) * steps, len(motion.phi) - 1)] - motion.phi[k * steps]).max()
        for k in range(len(motion.phases))
    ]
    kept = 2 + max((k for k, angle in enumerate(turned) if angle >= STILL), default=-1)
    end = kept * steps + 1
    return Motion(motion.phi[:end], motion.w[:end], motion.phases[:kept], motion.lifted[:kept])


def _skidding(state: SnakeState, params: SnakeParams) -> Motion:
    """Every joint turns straight to its target, and no wheel is ever lifted."""
    _, path = skid(state, params)
    turned = params.u_limit * params.dt * np.arange(len(path))[:, None]
    way = np.clip(state.target - state.phi, -turned, turned)
    nothing = np.zeros((0, params.n_joints), dtype=np.bool_)
    return Motion(state.phi + way, path, [], nothing)


def frame_steps(params: SnakeParams) -> int:
    """Sub-steps from one frame to the next."""
    return max(1, round(FRAME_EVERY_S / params.dt))


def encode(motion: Motion, params: SnakeParams) -> dict[str, Any]:
    """A motion for the page: a frame every :func:`frame_steps` sub-steps, and one at the end.

    Returns:
        ``end`` [s]; ``phi`` and, where the head moves, ``w`` (32-bit floats): frame by frame, in
        base64; ``phases``; ``lifted``: a number per interval, bit k - 1 is wheel k.
    """
    last = len(motion.phi) - 1
    frames = np.append(np.arange(0, last, frame_steps(params)), last)
    data: dict[str, Any] = {
        "end": round(last * params.dt, 6),
        "phi": encode_angles(motion.phi[frames]),
        "phases": motion.phases,
        "lifted": (motion.lifted @ (1 << np.arange(params.n_joints))).tolist(),
    }
    if not np.allclose(motion.w, params.w_d, rtol=0.0, atol=1e-6):
        data["w"] = _base64(motion.w[frames].astype("<f4"))
    return data


def encode_angles(phi: FloatArray) -> str:
    """Angles [rad] as multiples of :data:`QUANTUM`, 16-bit integers, little-endian, in base64."""
    return _base64(np.round(phi / QUANTUM).astype("<i2"))


def decode_angles(text: str, n_joints: int) -> FloatArray:
    """What ``robot.js`` makes of :func:`encode_angles`, shape (frames, n) [rad]."""
    numbers = np.frombuffer(base64.b64decode(text), dtype="<i2")
    angles: FloatArray = numbers.reshape(-1, n_joints) * QUANTUM
    return angles


def _base64(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode("ascii")
