"""State of the robot between two intervals: :class:`SnakeState`, and many at once: `StateBatch`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from snake_env.errors import InvalidInputError
from snake_env.kinematics import d_min
from snake_env.params import SnakeParams

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class SnakeState:
    """The robot at a switching time t_k.

    The arrays are this state's own: never write to them, make a new state instead.

    Attributes:
        w: Head pose (x_0, y_0, theta_0), shape (3,) [m, m, rad].
        phi: Joint angles, shape (n,) [rad].
        target: Target joint angles, shape (n,) [rad].
        phase: 1..n: the number of the joint that is the SCP; n + 1: the target is reached.
        phase_time: Time since the phase began [s].
        ref_start: The SCP's angle when the phase began, where its cam curve starts [rad].
        elapsed: Time since the episode began [s].
    """

    w: FloatArray
    phi: FloatArray
    target: FloatArray
    phase: int
    phase_time: float
    ref_start: float
    elapsed: float

    @classmethod
    def initial(cls, phi0: ArrayLike, target: ArrayLike, params: SnakeParams) -> SnakeState:
        """State in which an episode begins: phase 1, head at ``params.w_d``.

        Args:
            phi0: Initial joint angles, shape (n,) [rad].
            target: Target joint angles, shape (n,) [rad].
            params: The constants.

        Raises:
            InvalidInputError: A shape has a wrong length, is not finite, passes the joint limits or
                collides with itself (d_min < 2 l).
        """
        phi = checked_shape("phi0", phi0, params)
        wanted = checked_shape("target", target, params)
        return cls(
            w=np.array(params.w_d),
            phi=phi,
            target=wanted,
            phase=1,
            phase_time=0.0,
            ref_start=float(phi[0]),
            elapsed=0.0,
        )

    @property
    def done(self) -> bool:
        """Whether every joint has reached its target in its phase."""
        return self.phase > len(self.phi)

    def replace(self, **changes: Any) -> SnakeState:
        """A copy with some fields replaced."""
        return dataclasses.replace(self, **changes)


@dataclass(frozen=True)
class StateBatch:
    """Many states, field by field: the attributes are those of :class:`SnakeState`, in arrays.

    Attributes:
        w: Head poses, shape (N, 3) [m, m, rad].
        phi: Joint angles, shape (N, n) [rad].
        target: Target joint angles, shape (N, n) [rad].
        phase: Phases, shape (N,).
        phase_time: Times since the phase began, shape (N,) [s].
        ref_start: Where the cam curves start, shape (N,) [rad].
        elapsed: Times since the episodes began, shape (N,) [s].
    """

    w: FloatArray
    phi: FloatArray
    target: FloatArray
    phase: IntArray
    phase_time: FloatArray
    ref_start: FloatArray
    elapsed: FloatArray

    def __len__(self) -> int:
        return len(self.phase)

    def __getitem__(self, k: int) -> SnakeState:
        return SnakeState(
            w=self.w[k].copy(),
            phi=self.phi[k].copy(),
            target=self.target[k].copy(),
            phase=int(self.phase[k]),
            phase_time=float(self.phase_time[k]),
            ref_start=float(self.ref_start[k]),
            elapsed=float(self.elapsed[k]),
        )

    @classmethod
    def stack(cls, states: Sequence[SnakeState]) -> StateBatch:
        """A batch of the given states, copied."""
        return cls(
            w=np.array([state.w for state in states], dtype=np.float64),
            phi=np.array([state.phi for state in states], dtype=np.float64),
            target=np.array([state.target for state in states], dtype=np.float64),
            phase=np.array([state.phase for state in states], dtype=np.int64),
            phase_time=np.array([state.phase_time for state in states], dtype=np.float64),
            ref_start=np.array([state.ref_start for state in states], dtype=np.float64),
            elapsed=np.array([state.elapsed for state in states], dtype=np.float64),
        )

    def take(self, indices: ArrayLike) -> StateBatch:
        """The states at the given positions, in their order; an index may come many times."""
        chosen = np.asarray(indices, dtype=np.intp)
        return StateBatch(
            **{field.name: getattr(self, field.name)[chosen] for field in dataclasses.fields(self)}
        )


def checked_shape(field: str, shape: ArrayLike, params: SnakeParams) -> FloatArray:
    """A body shape as a fresh float64 array (n,) [rad], if an episode may begin or end with it.

    Raises:
        InvalidInputError: Wrong length, not finite, beyond the joint limits, or self-colliding.
    """
    try:
        phi = np.array(shape, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInputError(field, shape, f"{params.n_joints} joint angles [rad]") from None
    if phi.shape != (params.n_joints,):
        raise InvalidInputError(
            f"{field}.shape", phi.shape, f"({params.n_joints},), one angle per joint"
        )
    for k, angle in enumerate(phi):
        name = f"{field}[{k}]"
        if not np.isfinite(angle):
            raise InvalidInputError(name, float(angle), "a finite angle [rad]")
        if abs(angle) > params.phi_limit + params.limit_tolerance:
            raise InvalidInputError(
                name, float(angle), f"at most phi_limit = {params.phi_limit:.6f} rad in size"
            )
    distance = d_min(phi, params.l)
    if distance < params.d_collision:
        raise InvalidInputError(
            field,
            np.round(phi, 3).tolist(),
            f"links at least {params.d_collision:.3f} m apart; here d_min = {distance:.3f} m",
        )
    return phi
