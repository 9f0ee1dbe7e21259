"""d_min of body shapes: a program of its own, as states are checked before any kernel is needed."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.kinematics import least_squared_distance, locate
from snake_env.equations.scalars import Scalar, sqrt
from snake_env.kernel.lane_function import LaneFunction
from snake_env.params import SnakeParams

_CONSTANTS = SnakeParams()  # the program reads none of them


def d_min(phi: NDArray[np.float64], l: float) -> float:  # noqa: E741
    """Least distance between links that could collide.

    Args:
        phi: Joint angles, shape (n,) [rad].
        l: Half a link's length [m].

    Returns:
        The distance [m], bit for bit what an interval's ``d_min`` is made of.
    """
    return float(get_distance_program(len(phi)).of_one(_CONSTANTS, (phi, l), np.float64)[0])


def least_distances(phi: NDArray[np.float64], l: float) -> NDArray[np.float64]:  # noqa: E741
    """d_min of many shapes, (N, n) [rad]: shape (N,) [m]."""
    program = get_distance_program(phi.shape[1])
    lengths = np.full(len(phi), l)
    distances: NDArray[np.float64] = program.of_many(_CONSTANTS, (phi, lengths), np.float64)[:, 0]
    return distances


def _distance(p: SnakeParams, phi: Sequence[Scalar], l: Scalar) -> list[Scalar]:  # noqa: E741
    return [sqrt(least_squared_distance(locate(phi, l)))]


@functools.cache
def get_distance_program(n_joints: int) -> LaneFunction:
    """The shared program for this size, compiled or loaded from the cache on first use."""
    return LaneFunction(_distance, (n_joints, 1), True, f"the distances of {n_joints} joints")
