"""The motion inside an interval, sub-step by sub-step: for pictures and replays."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from snake_env.kernel.blocks import clock_of
from snake_env.kernel.interval import RUNNING
from snake_env.params import SnakeParams
from snake_env.sim.lanes import check_pairs, checked_modes, run_lanes
from snake_env.state import FloatArray, SnakeState, StateBatch, read_only, remade


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The motion inside one interval, at each sub-step. The arrays are read-only.

    Attributes:
        t: Times inside the interval, shape (K + 1,) [s].
        phi: Joint angles, shape (K + 1, n) [rad].
        w: Head pose, shape (K + 1, 3) [m, m, rad].
        u: Joint input between them, shape (K, n) [rad/s].
    """

    t: FloatArray
    phi: FloatArray
    w: FloatArray
    u: FloatArray

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, read_only(getattr(self, field.name)))

    def __reduce__(self) -> tuple[Any, ...]:
        return remade(self)


def trajectories(states: StateBatch, modes: ArrayLike, params: SnakeParams) -> list[Trajectory]:
    """The motion of N states through one interval, with one mode each, sub-step by sub-step.

    Args:
        states: N states at their t_k.
        modes: One mode index per state, shape (N,).
        params: The constants.

    Raises:
        InvalidModeError: A mode is out of range or not valid in its state's phase.
        InvalidInputError: The states do not fit the constants or the modes.
    """
    chosen = checked_modes(modes)
    check_pairs(states, chosen, params)
    clock = clock_of(params)
    n_steps = len(clock)
    now = states
    phi, w, u = [states.phi], [states.w], []
    running = np.zeros((len(chosen), n_steps), dtype=np.bool_)
    ended = np.zeros(len(chosen), dtype=np.bool_)
    for step in range(n_steps):
        outcome = run_lanes(now, chosen, params, clock[step : step + 1])
        running[:, step] = ~ended & (outcome["duration"][:, 0] > 0.0)
        ended |= outcome["violation"][:, 0] != RUNNING
        now = dataclasses.replace(now, phi=outcome["phi"], w=outcome["w"])
        phi.append(outcome["phi"])
        w.append(outcome["w"])
        u.append(outcome["u"])
    times = np.append(clock[:, 0], params.delta_t)
    result = []
    for lane, length in enumerate(running.sum(axis=1)):
        result.append(
            Trajectory(
                t=times[: length + 1],
                phi=np.array([step[lane] for step in phi[: length + 1]]),
                w=np.array([step[lane] for step in w[: length + 1]]),
                u=np.array([step[lane] for step in u[:length]]).reshape(length, params.n_joints),
            )
        )
    return result


def trajectory(state: SnakeState, mode: int, params: SnakeParams) -> Trajectory:
    """The motion through one interval with a mode, sub-step by sub-step, up to a violation.

    Raises:
        InvalidModeError: The mode is out of range or not valid in the phase.
    """
    return trajectories(StateBatch.stack([state]), [mode], params)[0]
