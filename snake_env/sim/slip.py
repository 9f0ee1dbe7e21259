"""Slip of the wheels: after each interval the head is displaced at random (section VI).

The paper's robot ended with an error of the shape, which its authors suspect came from lateral slip.
Here the head's pose is off by normally distributed amounts after each interval; joints are where they
are measured.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from snake_env.errors import InvalidInputError, as_finite
from snake_env.params import SnakeParams
from snake_env.sim.simulation import Prediction, advance
from snake_env.state import FloatArray, SnakeState, StateBatch

Slip = tuple[float, float]
"""Standard deviations for an interval: of the head's x and y [m], of its heading [rad]."""

NO_SLIP: Slip = (0.0, 0.0)
MOST_SLIP = 10.0


def check_slip(given: Any) -> Slip:
    """Validates a slip.

    Raises:
        InvalidInputError: It is not two numbers, zero or positive.
    """
    scales = (
        [as_finite(scale) for scale in given] if isinstance(given, (Sequence, np.ndarray)) else []
    )
    if len(scales) != 2 or any(scale is None or not 0.0 <= scale <= MOST_SLIP for scale in scales):
        expected = f"(m, rad): two numbers from 0 to {MOST_SLIP:g}"
        raise InvalidInputError("slip", given, expected)
    return float(scales[0] or 0.0), float(scales[1] or 0.0)


def slip_of_each(given: Any, count: int) -> FloatArray | None:
    """How much each of some robots slips, shape (count, 2); None where there is one slip for all.

    Raises:
        InvalidInputError: There is not one for each robot, or one can't be used.
    """
    several = isinstance(given, (Sequence, np.ndarray)) and len(given) and np.ndim(given[0]) == 1
    if not several:
        return None
    if len(given) != count:
        expected = f"(m, rad), or one pair for each of {count} robots"
        raise InvalidInputError("slip", f"{len(given)} pairs", expected)
    return np.array([check_slip(pair) for pair in given])


def slipped(
    w: FloatArray, slip: Slip | FloatArray, rngs: Sequence[np.random.Generator]
) -> FloatArray:
    """Where heads are after an interval.

    Args:
        w: Where the model says, shape (N, 3) [m, m, rad].
        slip: How much they slip; or how much each does, shape (N, 2).
        rngs: N sources of randomness.
    """
    scales = np.broadcast_to(_of_pose(slip), w.shape)
    there = w.copy()
    for k in np.flatnonzero(scales.any(axis=1)).tolist():  # without slip no random number is drawn
        there[k] += rngs[k].normal(0.0, scales[k])
    return there


def randomised_slips(slip: Slip, count: int, rng: np.random.Generator) -> FloatArray:
    """Domain randomisation: of some episodes each slips by its own share of ``slip``, from 0 to 2.

    Args:
        slip: The middle.
        count: Number of episodes, N.
        rng: Source of randomness; not used where nothing slips.

    Returns:
        Standard deviations for an interval, shape (N, 3) [m, m, rad].
    """
    shares = rng.uniform(0.0, 2.0, count) if any(slip) else np.zeros(count)
    return shares[:, None] * _of_pose(slip)


def slip_batch(states: StateBatch, scales: FloatArray, rng: np.random.Generator) -> StateBatch:
    """States in which the heads have slipped.

    Args:
        states: N states at the end of an interval.
        scales: Their standard deviations, shape (N, 3), as :func:`randomised_slips` gives them.
        rng: Source of randomness; not used where nothing slips.
    """
    if not scales.any():
        return states
    return dataclasses.replace(states, w=states.w + scales * rng.normal(size=states.w.shape))


def _of_pose(slip: Slip | FloatArray) -> FloatArray:
    """Standard deviations of x, y and heading, (..., 3), from those of place and heading, (..., 2)."""
    scales: FloatArray = np.asarray(slip, dtype=np.float64)[..., [0, 0, 1]]
    return scales


class SlipProcess:
    """Slip in one episode: executes modes and displaces the head after each interval.

    Args:
        slip: How much it slips.
        task: The task's id: the k-th slip of a task is always the same, whatever the policy.
        params: The constants.
    """

    def __init__(self, slip: Slip, task: int, params: SnakeParams) -> None:
        self._slip, self._params = slip, params
        stream = np.random.SeedSequence(task, spawn_key=(0, 0))  # a policy draws from (task,)
        self._rngs = [np.random.default_rng(stream)]

    def advance(self, state: SnakeState, mode: int) -> tuple[SnakeState, Prediction]:
        """:func:`snake_env.sim.simulation.advance`, and the slip."""
        after, prediction = advance(state, mode, self._params)
        w = slipped(after.w[None], self._slip, self._rngs)[0]
        return dataclasses.replace(after, w=w), prediction
