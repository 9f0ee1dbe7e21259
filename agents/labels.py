"""Labels for imitation: states, and what every mode of each would cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.envs.reward import RewardWeights
from snake_env.state import IntArray, StateBatch

REWARD = RewardWeights()
"""The env's reward, in whose units action values are learned."""
STATE_FIELDS = tuple(field.name for field in dataclasses.fields(StateBatch))


@dataclass(frozen=True, eq=False)
class Decisions:
    """States, and what a teacher says about their modes.

    Attributes:
        states: N states.
        mask: Which modes were asked about, of those in the instant mask, shape (N, n_modes).
        feasible: Which of them hold (22) and (23) throughout the interval, shape (N, n_modes).
        cost_to_go: Intervals to the target with each mode, itself included, shape (N, n_modes);
            infinite where infeasible.
    """

    states: StateBatch
    mask: NDArray[np.bool_]
    feasible: NDArray[np.bool_]
    cost_to_go: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.states)

    def take(self, indices: IntArray) -> Decisions:
        """The decisions at the given positions."""
        return Decisions(
            self.states.take(indices),
            self.mask[indices],
            self.feasible[indices],
            self.cost_to_go[indices],
        )


def join(parts: Sequence[Decisions]) -> Decisions:
    """Decisions one after the other."""
    return Decisions(
        StateBatch(
            **{
                name: np.concatenate([getattr(part.states, name) for part in parts])
                for name in STATE_FIELDS
            }
        ),
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("mask", "feasible", "cost_to_go")
        ),
    )
