"""The robot's mirror image: phi to -phi and y to -y; the lifted wheels stay the same.

Every state is worth what its mirror image is worth, so each observation teaches twice, and a network
that is asked about both errs less.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from snake_env.features import SUPPORT_DIRECTIONS
from snake_env.network import Float32Array, Network
from snake_env.observation import observation_rows

_NEGATED = {"phi", "target", "error", "scp_error", "ref_start", "last_turn"}
_POINTS = {"link_direction", "link_centre", "centre_of_gravity"}


@functools.cache
def mirror(n_joints: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """How observations are mirrored: ``observation[..., order] * sign``.

    Returns:
        ``order`` and ``sign``, each of shape (observation_size,).
    """
    order: list[int] = []
    sign: list[float] = []
    for name, size in observation_rows(n_joints):
        first = len(order)
        positions, signs = list(range(first, first + size)), [1.0] * size
        if name in _NEGATED:
            signs = [-1.0] * size
        elif name in _POINTS:  # x and y in turns
            signs = [1.0, -1.0] * (size // 2)
        elif name == "head_error":  # x, y, heading
            signs = [1.0, -1.0, -1.0]
        elif name == "support_margin":  # in directions k * 45 degrees: k becomes -k
            positions = [first + -k % SUPPORT_DIRECTIONS for k in range(SUPPORT_DIRECTIONS)]
        order += positions
        sign += signs
    return np.array(order), np.array(sign, dtype=np.float32)


def preferences(network: Network, observations: Float32Array, n_joints: int) -> Float32Array:
    """What a network prefers in states and in their mirror images, added up.

    Args:
        network: From observations to a preference for each mode.
        observations: Shape (N, observation_size).
        n_joints: Joints of the robots.

    Returns:
        Shape (N, n_modes).
    """
    order, sign = mirror(n_joints)
    images = observations[:, order]
    images *= sign
    both = network(np.concatenate([observations, images]))
    count = len(observations)
    result: Float32Array = both[:count] + both[count:]
    return result
