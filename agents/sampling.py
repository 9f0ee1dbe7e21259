"""Which modes of a state are tried in training: all, or of very many a random choice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.state import IntArray, StateBatch

MOST = 64
"""Of a state: with ten joints up to 466 modes are valid, and to try them all costs most of the time."""


def sampled_modes(
    states: StateBatch,
    rng: np.random.Generator,
    params: SnakeParams,
    also: IntArray | None = None,
) -> NDArray[np.bool_]:
    """Which modes to try.

    Args:
        states: N states.
        rng: Source of randomness.
        params: The constants.
        also: A valid mode of each state that is tried in any case, shape (N,).

    Returns:
        Shape (N, n_modes): the modes that the phase allows, at most :data:`MOST` random ones of them.
    """
    valid = mode_table(params.n_joints).masks(states.phase)
    many = np.flatnonzero(valid.sum(axis=1) > MOST)
    if len(many) == 0:
        return valid
    order = np.where(valid[many], rng.random((len(many), valid.shape[1])), 2.0)
    if also is not None:
        order[np.arange(len(many)), also[many]] = -1.0
    tried = valid.copy()
    tried[many] = False
    tried[many[:, None], np.argpartition(order, MOST, axis=1)[:, :MOST]] = True
    return tried
