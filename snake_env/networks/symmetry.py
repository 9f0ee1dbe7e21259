"""The robot's mirror image: phi to -phi and y to -y; the lifted wheels stay the same.

Every state is worth what its mirror image is worth, and has the same best mode. A policy's network is
asked about both, and the mean of its answers counts: it errs less. Value networks, asked about
many states at a time, see one of the two, always the same one: it takes half the time.
"""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.features import SUPPORT_DIRECTIONS
from snake_env.errors import InvalidInputError
from snake_env.networks.network import Float32Array, Network
from snake_env.params import N_JOINTS_RANGE
from snake_env.sim.observation import observation_rows, observation_size

Images = Literal["canonical", "both", "given"]
"""Which image of a state a network is asked about: the canonical one, both (the mean of its answers
counts), or the state as it is given."""

_NEGATED = {"phi", "target", "error", "scp_error", "ref_start", "last_turn"}
_POINTS = {"link_direction", "link_centre", "centre_of_gravity"}


@functools.cache
def mirror(n_joints: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """How observations are mirrored: ``observation[..., order] * sign``.

    Returns:
        ``order`` and ``sign``, each of shape (observation_size,), read-only.
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
    result = np.array(order), np.array(sign, dtype=np.float32)
    for array in result:
        array.setflags(write=False)
    return result


def canonical_sign_index(size: int) -> int:
    """Position of the value whose sign distinguishes the two images: not negative in the canonical one.

    It is the last joint's target, which stays the same through an episode: all that is compared within
    one is seen from the same side.

    Args:
        size: Values in an observation.
    """
    return 2 * joints_observed(size) - 1  # targets come after angles


@functools.cache
def joints_observed(size: int) -> int:
    """Number of joints of the robots whose observations have this size.

    Raises:
        InvalidInputError: No robot's observation has this size.
    """
    low, high = N_JOINTS_RANGE
    sizes = {observation_size(n): n for n in range(low, high + 1)}
    if size not in sizes:
        raise InvalidInputError("observation_size", size, f"one of {list(sizes)}")
    return sizes[size]


class SymmetricNetwork:
    """A network that is asked about states and about their mirror images: the mean of its answers.

    Args:
        network: Takes observations.
        n_joints: Joints of the robots.
    """

    def __init__(self, network: Network, n_joints: int) -> None:
        self._network, self._n_joints = network.prepared(), n_joints

    def __call__(self, observations: Float32Array) -> Float32Array:
        """Outputs, shape (N, outputs), for observations of shape (N, inputs)."""
        images = _mirrored(observations, self._n_joints)
        answers = self._network(np.concatenate((observations, images)))
        result = answers[: len(images)]
        result += answers[len(images) :]
        result *= 0.5
        return result


class CanonicalNetwork:
    """A network that is asked about one image of each state, the canonical one.

    That is the image in which the value at :func:`canonical_sign_index` is not negative.

    Args:
        network: Takes observations.
        n_joints: Joints of the robots.
    """

    def __init__(self, network: Network, n_joints: int) -> None:
        self._network, self._n_joints = network.prepared(), n_joints
        self._sign_index = canonical_sign_index(network.sizes[0])

    def __call__(self, observations: Float32Array) -> Float32Array:
        """Outputs, shape (N, outputs), for observations of shape (N, inputs)."""
        as_it_is = observations[:, self._sign_index, None] >= 0.0
        if not as_it_is.all():
            images = _mirrored(observations, self._n_joints)
            observations = np.where(as_it_is, observations, images)
        return self._network(observations)


def with_images(
    network: Network, n_joints: int, images: Images
) -> CanonicalNetwork | SymmetricNetwork | Network:
    """A network that takes observations, and is asked about some images of the states."""
    if images == "given":
        return network.prepared()
    return (CanonicalNetwork if images == "canonical" else SymmetricNetwork)(network, n_joints)


def _mirrored(observations: Float32Array, n_joints: int) -> Float32Array:
    """The mirror images of observations, shape (N, inputs)."""
    order, sign = mirror(n_joints)
    images = observations.take(order, axis=1)
    images *= sign
    return images
