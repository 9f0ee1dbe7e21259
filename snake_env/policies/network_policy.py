"""Learned policies: one evaluation of a network for a decision, and no model roll-out.

The network sees the state and its mirror image, side by side; what it prefers is the mean.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.networks.model_file import Model
from snake_env.networks.symmetry import SymmetricNetwork
from snake_env.params import SnakeParams
from snake_env.sim.episode import STILL
from snake_env.sim.observation import observe_one
from snake_env.state import IntArray, SnakeState


class NetworkPolicy:
    """The mode that a network prefers among those that are stable at t_k.

    A choice that left the robot where it was would do so again: as long as the robot stands still, it
    is not repeated.

    Args:
        params: The constants.
        model: Of the kind ``policy``.

    Raises:
        InvalidInputError: The model is not for these robots, or of another kind.
    """

    def __init__(self, params: SnakeParams, model: Model) -> None:
        model.check(params, "policy")
        self.rollouts = 0
        self._params = params
        self._network = SymmetricNetwork(model.network, params.n_joints)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode: nothing has been tried."""
        self._tried: list[int] = []
        self._where: tuple[int, NDArray[np.float64]] | None = None

    def select_mode(self, state: SnakeState) -> int:
        """The mode of highest preference."""
        mode = int(self._preferences(state).argmax())
        self._tried.append(mode)
        return mode

    def ranking(self, state: SnakeState) -> IntArray:
        """All modes that the mask allows, the preferred ones first; nothing counts as tried."""
        ranks = self._preferences(state)
        order = np.argsort(-ranks, kind="stable")
        ranked: IntArray = order[: int(np.isfinite(ranks).sum())]
        return ranked

    def _preferences(self, state: SnakeState) -> NDArray[np.float32]:
        """What the network prefers; minus infinity where a mode is out of the question."""
        observation, mask = observe_one(state, self._params)
        ranks: NDArray[np.float32] = self._network(observation[None])[0]
        ranks[~mask] = -np.inf
        if self._has_moved(state):
            self._where = state.phase, state.phi
            self._tried.clear()
        elif len(self._tried) < np.count_nonzero(mask):
            ranks[self._tried] = -np.inf
        return ranks

    def _has_moved(self, state: SnakeState) -> bool:
        """Whether the robot is somewhere else than where the modes were tried."""
        if self._where is None or abs(state.last_turn) >= STILL:  # the SCP tells soonest
            return True
        phase, phi = self._where
        return phase != state.phase or bool(np.abs(state.phi - phi).max() >= STILL)
