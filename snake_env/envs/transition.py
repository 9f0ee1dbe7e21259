"""One decision of an agent: like :func:`advance`, but nothing that an agent may do is an error."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import InvalidModeError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.simulation import Prediction, least_distances, predict_batch, successors
from snake_env.state import IntArray, StateBatch

OnInfeasible = Literal["terminate", "reject"]
INVALID_MODE = "invalid_mode"
"""Violation of a choice that lifts the SCP's wheel or one before it: nothing is executed."""


@dataclass(frozen=True, eq=False)
class Transition:
    """What N decisions led to.

    Attributes:
        after: The states at t_{k+1}.
        prediction: What the robots did; where nothing was executed, that they held still.
        violation: What was wrong with each choice, ``""`` where it was feasible, shape (N,).
        executed: Whether the mode was executed at all, shape (N,).
    """

    after: StateBatch
    prediction: Prediction
    violation: NDArray[np.str_]
    executed: NDArray[np.bool_]


def transition(
    states: StateBatch, modes: IntArray, on_infeasible: OnInfeasible, params: SnakeParams
) -> Transition:
    """Executes modes that agents chose.

    Args:
        states: N states that have not reached their target.
        modes: Mode indices, shape (N,); a mode that the phase does not allow is a violation.
        on_infeasible: After a violation, ``terminate`` leaves the robot where it occurred; with
            ``reject`` the mode is not executed: the robot holds still for the interval, no violation
            is recorded and no cost is added.
        params: The constants.

    Raises:
        InvalidModeError: A mode is not in the table at all.
    """
    table = mode_table(params.n_joints)
    outside = (modes < 0) | (modes >= len(table))
    if outside.any():
        raise InvalidModeError("action", int(modes[outside][0]), f"0 to {len(table) - 1}")
    allowed = table.masks(states.phase)[np.arange(len(modes)), modes]
    executed = np.where(allowed, modes, 0)  # no phase forbids mode 0
    prediction = predict_batch(states, executed, params)
    violation = np.where(allowed, prediction.violation, INVALID_MODE)
    reject = on_infeasible == "reject"
    held = violation != "" if reject else ~allowed
    if held.any():
        duration, recorded = (params.delta_t, "") if reject else (0.0, INVALID_MODE)
        prediction = Prediction(
            phi=np.where(held[:, None], states.phi, prediction.phi),
            w=np.where(held[:, None], states.w, prediction.w),
            cost=np.where(held, 0.0, prediction.cost),
            j=np.where(held, np.inf, prediction.j),
            feasible=prediction.feasible & ~held,
            violation=np.where(held, recorded, prediction.violation),
            d_min=np.where(held, least_distances(states.phi, params), prediction.d_min),
            max_abs_phi=np.where(held, np.abs(states.phi).max(axis=1), prediction.max_abs_phi),
            duration=np.where(held, duration, prediction.duration),
        )
    after = successors(states, modes, prediction, params)
    after = dataclasses.replace(  # the cam curve waits for a robot that holds still
        after, phase_time=np.where(held, states.phase_time, after.phase_time)
    )
    return Transition(after, prediction, violation, executed=~held)
