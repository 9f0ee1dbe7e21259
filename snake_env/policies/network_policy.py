"""Learned policies: one evaluation of a network for a decision, and no model roll-out.

The network sees the state and its mirror image, side by side, and what it prefers is the mean; others
see the state alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from snake_env.networks.model_file import Model
from snake_env.networks.symmetry import with_images
from snake_env.params import SnakeParams
from snake_env.sim.episode import has_moved
from snake_env.sim.lanes import check_running
from snake_env.sim.observation import get_observation_kernel, observation_and_mask
from snake_env.state import IntArray, SnakeState


class NetworkPolicy:
    """The mode that a network prefers among those that are stable at t_k.

    A mode that left the robot where it was would do so again. As long as the robot stands still, no
    mode that was executed is chosen again while there are others (the no-repeat rule).

    Attributes:
        rollouts: Always 0.
        models: Its model.

    Args:
        params: The constants.
        model: Of the kind ``policy``.
        transfer: Whether the constants may differ from those that the model was trained with.

    Raises:
        InvalidInputError: The model was trained with other constants, or is of another kind.
    """

    def __init__(self, params: SnakeParams, model: Model, transfer: bool = False) -> None:
        model.check(params, "policy", transfer=transfer)
        self.rollouts = 0
        self.models = (model,)
        self._params = params
        get_observation_kernel(params.n_joints, params.head_contact)
        self._network = with_images(model.network, params.n_joints, model.images)
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode: nothing has been tried."""
        self._tried: set[int] = set()
        self._asked_at = -1.0
        self._where: tuple[int, NDArray[np.float64]] | None = None

    def select_mode(self, state: SnakeState) -> int:
        """The mode of highest logit."""
        observation, allowed = self._allowed(state)
        logits = self._network(observation[None])[0]
        logits[~allowed] = -np.inf
        return int(logits.argmax())

    def ranking(self, state: SnakeState, unless: int = 0) -> IntArray:
        """The modes that may be chosen, the preferred ones first; ties go to the lowest index.

        Args:
            state: The robot at t_k.
            unless: Where there are no more modes than this, the network is not asked, and they come in
                the order of their numbers.
        """
        observation, allowed = self._allowed(state)
        modes: IntArray = np.flatnonzero(allowed)
        if len(modes) <= unless:
            return modes
        logits = self._network(observation[None])[0][modes]
        ranked: IntArray = modes[np.argsort(-logits, kind="stable")]
        return ranked

    def _allowed(self, state: SnakeState) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """The observation, and the modes that are stable at t_k, but for those tried in vain."""
        observation, mask = observation_and_mask(state, self._params)
        check_running(state)
        if self._where is None or has_moved(*self._where, state):
            self._where = state.phase, state.phi
            self._tried.clear()
        elif state.elapsed != self._asked_at and state.last_mode >= 0:
            self._tried.add(state.last_mode)  # what was executed, whoever chose it
        self._asked_at = state.elapsed
        if self._tried:
            left = mask.copy()
            left[list(self._tried)] = False
            mask = left if left.any() else mask
        return observation, mask
