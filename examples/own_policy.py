"""Your own agent in an evaluation: a class with ``reset``, ``select_mode`` and ``rollouts``.

    python -m evaluate analytic --policy examples.own_policy:Careful --tasks random:200

``--policy`` takes MODULE:FACTORY. The factory, here the class itself, is called with the constants.
"""

import numpy as np

from snake_env import ModeTable, SnakeParams, SnakeState, predict


class Careful:
    """Takes the feasible mode that keeps all joints farthest from their limits."""

    def __init__(self, params: SnakeParams) -> None:
        self.params, self.table = params, ModeTable(params.n_joints)
        self.rollouts = 0  # modes predicted so far: the cost of deciding

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; an agent that draws random numbers draws them from ``seed``."""

    def select_mode(self, state: SnakeState) -> int:
        """The index of a mode that the phase allows."""
        modes = np.flatnonzero(self.table.mask(state.phase))
        prediction = predict(state, modes, self.params)
        self.rollouts += len(modes)
        return int(modes[np.where(prediction.feasible, prediction.max_abs_phi, 9.9).argmin()])
