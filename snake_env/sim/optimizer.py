"""The paper's choice of the mode, (21)-(25): predict every candidate, take the cheapest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.simulation import Prediction, predict
from snake_env.state import IntArray, SnakeState


@dataclass(frozen=True, eq=False)
class Selection:
    """The optimiser's choice and its reasons.

    Attributes:
        mode: The feasible mode of least J, or None: no candidate is feasible (a deadlock).
        modes: The candidates' indices, in rising order, shape (M,).
        prediction: What each candidate would do: its ``j``, or the ``violation`` that refused it.
    """

    mode: int | None
    modes: IntArray
    prediction: Prediction

    @property
    def last_resort(self) -> int:
        """The choice, or where nothing is feasible the candidate that holds out longest."""
        if self.mode is not None:
            return self.mode
        return int(self.modes[np.argmax(self.prediction.duration)])


class AnalyticOptimizer:
    """Solves (21) by comparing J over all candidates.

    Args:
        params: The constants.
        candidates: For each phase, which modes may be chosen, shape (n, n_modes); default: all
            that the phase allows.

    Raises:
        InvalidInputError: ``candidates`` has a wrong shape or leaves a phase without a mode.
    """

    def __init__(self, params: SnakeParams, candidates: NDArray[np.bool_] | None = None) -> None:
        self.params = params
        table = mode_table(params.n_joints)
        phases = range(1, params.n_joints + 1)
        masks = [table.mask(phase) for phase in phases]
        if candidates is not None:
            wanted = (params.n_joints, len(table))
            if candidates.shape != wanted:
                raise InvalidInputError("candidates.shape", candidates.shape, str(wanted))
            masks = [mask & allowed for mask, allowed in zip(masks, candidates, strict=True)]
        self._modes = {p: np.flatnonzero(mask) for p, mask in zip(phases, masks, strict=True)}
        for phase, modes in self._modes.items():
            modes.setflags(write=False)
            if len(modes) == 0:
                raise InvalidInputError(
                    "candidates", phase, "at least one valid mode in each phase"
                )

    def modes(self, phase: int) -> IntArray:
        """The candidates in a phase, in rising order, shape (M,).

        Raises:
            InvalidInputError: There is no such phase.
        """
        if phase not in self._modes:
            raise InvalidInputError("state.phase", phase, f"1 to {self.params.n_joints}")
        return self._modes[phase]

    def select(self, state: SnakeState) -> Selection:
        """Predicts all candidates in one pass of the kernel and compares them.

        Ties go to the lowest index.

        Raises:
            InvalidInputError: The state has reached its target, or does not fit the constants.
        """
        modes = self.modes(state.phase)
        prediction = predict(state, modes, self.params)
        best = int(np.argmin(prediction.j))
        mode = int(modes[best]) if prediction.feasible[best] else None
        return Selection(mode, modes, prediction)
