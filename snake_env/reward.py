"""Rewards: named terms, each with a weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from snake_env.params import SnakeParams
from snake_env.simulation import Prediction
from snake_env.state import StateBatch


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward's terms.

    No term can be collected by lingering: time always costs, and a phase ends only once.
    """

    time: float = -0.02  # per interval, as a share of it: a violation ends the interval early
    phase: float = 0.1  # per phase completed
    success: float = 1.0  # when the target is reached
    violation: float = -1.0  # when (22) or (23) is broken, or links touch
    cost: float = -0.002  # per unit of V's mean over the interval


def reward_terms(
    before: StateBatch,
    after: StateBatch,
    prediction: Prediction,
    weights: RewardWeights,
    params: SnakeParams,
) -> dict[str, NDArray[Any]]:
    """The weighted terms of N transitions; the reward is their sum.

    Args:
        before: N states at t_k.
        after: The states at t_{k+1}.
        prediction: What happened in between.
        weights: The terms' weights.
        params: The constants.

    Returns:
        For each term, its weighted value, shape (N,).
    """
    touched = prediction.d_min < params.d_touch
    reached = prediction.feasible & ~touched & (after.phase > params.n_joints)
    return {
        "time": weights.time * prediction.duration / params.delta_t,
        "phase": weights.phase * (after.phase - before.phase),
        "success": weights.success * reached,
        "violation": weights.violation * (~prediction.feasible | touched) + 0.0,
        "cost": weights.cost * prediction.cost / params.delta_t,
    }
