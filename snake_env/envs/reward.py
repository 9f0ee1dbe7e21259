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
"""Most that the mean of V counts: near singular shapes it reaches 2000, as it means little there."""


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward's terms.

    No term can be collected by lingering: time always costs, and a phase ends only once.
    """

    time: float = -0.02  # per interval; a violation may end it early
    phase: float = 0.1  # per phase completed
    success: float = 1.0  # when the target is reached
    violation: float = -1.0  # when a choice was infeasible or not allowed, or links touch
    cost: float = -0.002  # per unit of V's mean over the interval, 10 at most
    shaping: float = 0.0  # times gamma Phi(after) - Phi(before): changes no optimal policy
    gamma: float = 0.99  # the agent's discount, for shaping


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
    ended: NDArray[np.bool_],
    weights: RewardWeights,
    params: SnakeParams,
) -> dict[str, NDArray[Any]]:
    """The weighted terms of N transitions; the reward is their sum.

    Args:
        before: N states at t_k.
        after: The states at t_{k+1}.
        prediction: What happened in between.
        ended: Which transitions terminated their episode, shape (N,): Phi is 0 there.
        weights: The terms' weights.
        params: The constants.

    Returns:
        For each term, its weighted value, shape (N,).
    """
    touched = prediction.d_min < params.d_touch
    reached = prediction.feasible & ~touched & (after.phase > params.n_joints)
    phi_after = np.where(ended, 0.0, potential(after, params))
    difference = weights.gamma * phi_after - potential(before, params)
    return {
        "time": weights.time * prediction.duration / params.delta_t,
        "phase": weights.phase * (after.phase - before.phase),
        "success": weights.success * reached,
        "violation": weights.violation * (~prediction.feasible | touched) + 0.0,
        "cost": weights.cost * np.minimum(prediction.cost / params.delta_t, COST_CAP),
        "shaping": weights.shaping * difference,
    }
