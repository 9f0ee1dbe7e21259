"""Rewards: named terms, each with a weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from snake_env.params import SnakeParams
from snake_env.sim.simulation import Prediction
from snake_env.state import FloatArray, StateBatch

COST_CAP = 10.0
"""Cap on the mean of V in the reward: near singular shapes V reaches 2000, where it means little."""


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward's terms.

    With the defaults, the undiscounted return of a success is 1 - 0.1 times its intervals, at least -9,
    and that of every failure is -30, however and whenever it comes: by a violation, standing still, or
    at the horizon. So the mean return ranks policies by success, then by time: one failure in
    a thousand weighs as much as 0.3 intervals of every episode. Giving up early never pays.
    """

    time: float = -0.1
    """Per interval; a violation may end it early."""
    success: float = 1.0
    """When the target is reached."""
    failure: float = -20.0
    """When an episode ends otherwise; the time left to the horizon is added."""
    violation: float = 0.0
    """When a choice was infeasible or not allowed; for training without masks."""
    cost: float = 0.0
    """Per unit of V's mean over the interval, 10 at most."""
    shaping: float = 0.0
    """Times gamma Phi(after) - Phi(before): changes no optimal policy."""
    gamma: float = 0.99
    """The agent's discount, for shaping."""


def potential(states: StateBatch, params: SnakeParams) -> FloatArray:
    """Phi of the shaping term, shape (N,): minus the phases left, this one by its error."""
    n = params.n_joints
    scp = np.minimum(states.phase, n) - 1
    lanes = np.arange(len(states))
    error = np.abs(states.target[lanes, scp] - states.phi[lanes, scp]) / (2.0 * params.phi_limit)
    left: FloatArray = np.where(states.phase > n, 0.0, n - states.phase + np.minimum(error, 1.0))
    return -left


def reward_terms(
    before: StateBatch,
    after: StateBatch,
    prediction: Prediction,
    outcome: NDArray[np.str_],
    weights: RewardWeights,
    params: SnakeParams,
) -> dict[str, NDArray[Any]]:
    """The weighted terms of N transitions; the reward is their sum.

    Args:
        before: N states at t_k.
        after: The states at t_{k+1}.
        prediction: What happened in between.
        outcome: How each episode ended with it, empty where it continues, shape (N,).
        weights: The terms' weights.
        params: The constants.

    Returns:
        For each term, its weighted value, shape (N,).
    """
    reached = outcome == "success"
    failed = (outcome != "") & ~reached
    left = np.maximum(params.horizon_s - after.elapsed, 0.0) / params.delta_t
    phi_after = np.where(outcome != "", 0.0, potential(after, params))  # also at the horizon
    difference = weights.gamma * phi_after - potential(before, params)
    return {
        "time": weights.time * prediction.duration / params.delta_t,
        "success": weights.success * reached,
        "failure": np.where(failed, weights.failure + weights.time * left, 0.0),
        "violation": weights.violation * ~prediction.feasible + 0.0,
        "cost": weights.cost * np.minimum(prediction.cost / params.delta_t, COST_CAP),
        "shaping": weights.shaping * difference,
    }
