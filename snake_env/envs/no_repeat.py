"""The no-repeat rule: a mode that left the robot where it was would do so again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.sim.episode import have_moved
from snake_env.state import IntArray, StateBatch


class NoRepeat:
    """Which modes N robots have executed since they last moved.

    The policies of :func:`snake_env.load_policy` follow the same rule by themselves
    (:class:`snake_env.policies.network_policy.NetworkPolicy`).

    Args:
        count: Number of robots.
        n_modes: Number of modes.
    """

    def __init__(self, count: int, n_modes: int) -> None:
        self._tried = np.zeros((count, n_modes), dtype=np.bool_)
        self._phase = np.zeros(count, dtype=np.int64)
        self._phi: NDArray[np.float64] | None = None

    def restart(self, indices: IntArray, states: StateBatch) -> None:
        """Records where episodes begin at the given positions."""
        if self._phi is None:
            self._phi = np.zeros((len(self._phase), states.phi.shape[1]))
        self._tried[indices] = False
        self._phase[indices], self._phi[indices] = states.phase, states.phi

    def record(self, indices: IntArray, modes: IntArray, after: StateBatch) -> None:
        """Records the modes that led to the given states."""
        assert self._phi is not None, "restart comes first"
        moved = have_moved(self._phase[indices], self._phi[indices], after)
        self._tried[indices, modes] = True
        self.restart(indices[moved], after.take(np.flatnonzero(moved)))

    def without_tried(self, indices: IntArray, masks: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Masks without the modes that have been tried, where any others are left."""
        left = masks & ~self._tried[indices]
        result: NDArray[np.bool_] = np.where(left.any(axis=1, keepdims=True), left, masks)
        return result
