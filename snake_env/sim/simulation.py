"""One interval of the hybrid system (3)-(4): ``predict`` it, ``advance`` through it.

Everything here goes through the one kernel, for one state or many.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from snake_env.equations.control import redundancy_gain
from snake_env.errors import InvalidInputError
from snake_env.kernel import distance
from snake_env.kernel.blocks import clock_of
from snake_env.kernel.interval import (
    BEYOND_LIMIT,
    RUNNING,
    UNSTABLE,
    get_cost_program,
)
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.lanes import (
    check_pairs,
    checked_for,
    checked_mode,
    checked_modes,
    run_lanes,
)
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch

VIOLATIONS = ("", "stability", "joint_limit")
"""Names of what can go wrong in an interval: nothing, (22), (23)."""

_NAMES = np.array(VIOLATIONS)
assert (RUNNING, UNSTABLE, BEYOND_LIMIT) == (0, 1, 2)  # they index VIOLATIONS


@dataclass(frozen=True, eq=False)
class Prediction:
    """What M lanes (a state with a mode each) do in one interval.

    A lane stops at its first violation: its fields then describe the time up to there.

    Attributes:
        phi: Joint angles at the end, shape (M, n) [rad].
        w: Head pose at the end, shape (M, 3) [m, m, rad].
        cost: Integral of V, shape (M,) [s].
        j: J of (24), shape (M,); infinite where infeasible.
        feasible: Whether (22) and (23) hold throughout, shape (M,).
        violation: Name of the first violation, shape (M,): ``""``, ``"stability"`` or
            ``"joint_limit"``.
        d_min: Least distance between links that could collide, over the shapes within the joint
            limits, shape (M,) [m].
        max_abs_phi: Largest joint angle in size, shape (M,) [rad].
        duration: Time until the end, or until the violation, shape (M,) [s].
    """

    phi: FloatArray
    w: FloatArray
    cost: FloatArray
    j: FloatArray
    feasible: NDArray[np.bool_]
    violation: NDArray[np.str_]
    d_min: FloatArray
    max_abs_phi: FloatArray
    duration: FloatArray

    def __len__(self) -> int:
        return len(self.j)

    def executable(self, params: SnakeParams) -> NDArray[np.bool_]:
        """Which lanes are feasible and let no links touch, shape (M,)."""
        return self.feasible & (self.d_min >= params.d_touch)

    def take(self, indices: IntArray) -> Prediction:
        """The lanes at the given positions."""
        fields = dataclasses.fields(self)
        return Prediction(**{field.name: getattr(self, field.name)[indices] for field in fields})


def predict(state: SnakeState, modes: ArrayLike, params: SnakeParams) -> Prediction:
    """Predicts one interval for each mode, in one pass of the kernel.

    Args:
        state: The robot at t_k.
        modes: Mode indices, shape (M,), each valid in the state's phase; repeats are allowed.
        params: The constants.

    Returns:
        The predictions, in the order of ``modes``.

    Raises:
        InvalidModeError: A mode is out of range or not valid in the phase.
        InvalidInputError: The state does not fit the constants.
    """
    return _predict(state, checked_for(state, modes, params), params)


def predict_batch(states: StateBatch, modes: ArrayLike, params: SnakeParams) -> Prediction:
    """Predicts one interval of many states, with one mode each.

    Args:
        states: N states at their t_k.
        modes: One mode index per state, shape (N,).
        params: The constants.

    Returns:
        The predictions, in the order of the states.

    Raises:
        InvalidModeError: A mode is out of range or not valid in its state's phase.
        InvalidInputError: The states do not fit the constants or the modes.
    """
    chosen = checked_modes(modes)
    check_pairs(states, chosen, params)
    return _predict(states, chosen, params)


def _predict(states: SnakeState | StateBatch, modes: IntArray, params: SnakeParams) -> Prediction:
    """:func:`predict_batch`, of one state with all modes too, once all has been checked."""
    outcome = run_lanes(states, modes, params, clock_of(params))
    lanes = np.arange(len(modes))
    # Where the target is reached there is no SCP, but no mode either.
    scp = np.minimum(states.phase, params.n_joints) - 1
    turned = np.abs((outcome["phi"] - states.phi)[lanes, scp])
    code = outcome["violation"][:, 0].astype(np.intp)
    feasible = code == 0
    integral = outcome["integral"][:, 0]
    j = params.a_scp / np.maximum(turned, 1e-12) + integral  # (24), (25)
    return Prediction(
        phi=outcome["phi"],
        w=outcome["w"],
        cost=integral,
        j=np.where(feasible, j, np.inf),
        feasible=feasible,
        violation=_NAMES[code],
        d_min=np.sqrt(outcome["d2_min"][:, 0]),
        max_abs_phi=outcome["max_abs_phi"][:, 0],
        duration=np.where(feasible, params.delta_t, outcome["duration"][:, 0]),
    )


def instantly_stable(
    states: StateBatch, modes: ArrayLike, params: SnakeParams
) -> NDArray[np.bool_]:
    """Whether (22) holds at t_k already, for many states with one mode each: the instant mask.

    Args:
        states: N states at their t_k.
        modes: One mode index per state, shape (N,).
        params: The constants.

    Returns:
        Shape (N,). Costs no roll-out: nothing is integrated.
    """
    chosen = checked_modes(modes)
    check_pairs(states, chosen, params)
    outcome = run_lanes(states, chosen, params, clock_of(params)[:0])
    stable: NDArray[np.bool_] = outcome["violation"][:, 0] == RUNNING
    return stable


def least_distances(phi: FloatArray, params: SnakeParams) -> FloatArray:
    """d_min of many shapes, (N, n) [rad]: shape (N,) [m], each bit for bit that of ``d_min``."""
    return distance.least_distances(phi, params.l)


def advance(state: SnakeState, mode: int, params: SnakeParams) -> tuple[SnakeState, Prediction]:
    """Executes a mode for one interval and shifts the phase where (18) holds.

    Args:
        state: The robot at t_k.
        mode: Mode index, valid in the state's phase.
        params: The constants.

    Returns:
        The robot at t_{k+1} and what happened (one lane). After a violation the robot is where it
        occurred, in the same phase.

    Raises:
        InvalidModeError: The mode is out of range or not valid in the phase.
    """
    after, prediction = advance_batch(StateBatch.stack([state]), [mode], params)
    return after[0], prediction


def advance_batch(
    states: StateBatch, modes: ArrayLike, params: SnakeParams
) -> tuple[StateBatch, Prediction]:
    """:func:`advance` for many states, with one mode each."""
    prediction = predict_batch(states, modes, params)
    return successors(states, modes, prediction, params), prediction


def successors(
    states: StateBatch, modes: ArrayLike, prediction: Prediction, params: SnakeParams
) -> StateBatch:
    """The states in which predicted intervals end, phases shifted where (18) holds."""
    lanes = np.arange(len(states))
    scp = states.phase - 1
    reached = prediction.phi[lanes, scp]
    error = np.abs(reached - states.target[lanes, scp])
    shift = prediction.feasible & (error < params.epsilon_p)  # (18)
    phase = states.phase + shift
    next_scp = np.minimum(phase, params.n_joints) - 1
    return StateBatch(
        w=prediction.w.copy(),
        phi=prediction.phi.copy(),
        target=states.target.copy(),
        phase=phase,
        phase_time=np.where(shift, 0.0, states.phase_time + prediction.duration),
        ref_start=np.where(shift, prediction.phi[lanes, next_scp], states.ref_start),
        elapsed=states.elapsed + prediction.duration,
        last_mode=np.array(modes, dtype=np.int64),
        last_turn=reached - states.phi[lanes, scp],
    )


def joint_input(state: SnakeState, mode: int, t: float, params: SnakeParams) -> FloatArray:
    """Joint input u of (29) for the given state at time ``t`` inside the interval.

    Args:
        state: The robot at that time (``phase_time`` is that of the interval's start, t_k).
        mode: Mode index, valid in the state's phase.
        t: Time since t_k, 0 to delta_t [s].
        params: The constants.

    Returns:
        Shape (n,) [rad/s], bit for bit what the kernel uses.

    Raises:
        InvalidModeError: The mode is out of range or not valid in the phase.
        InvalidInputError: ``t`` lies outside the interval.
    """
    if not isinstance(t, (int, float, np.number)) or not 0.0 <= t <= params.delta_t:
        raise InvalidInputError("t", t, f"a time from 0 to delta_t = {params.delta_t} s")
    chosen = checked_mode(state, mode, params)
    now = np.array([[float(t), redundancy_gain(float(t), params)]])
    u: FloatArray = run_lanes(state, chosen, params, now)["u"][0]
    return u


def cost(state: SnakeState, mode: int, params: SnakeParams) -> tuple[float, FloatArray]:
    """V of (19) and its gradient (14) for a state and a mode.

    Args:
        state: The robot.
        mode: Mode index, valid in the state's phase.
        params: The constants.

    Returns:
        V, and dV/dphi, shape (n,) [1/rad], bit for bit what the kernel uses.

    Raises:
        InvalidModeError: The mode is out of range or not valid in the phase.
    """
    chosen = checked_mode(state, mode, params)
    grounded = ~mode_table(params.n_joints).lifted_wheels(chosen, np.int64(state.phase))[0]
    program = get_cost_program(params.n_joints)
    values = program.of_one(params, (state.phi, float(state.phase), grounded), np.float64)
    return float(values[0]), values[1:]


def any_feasible(state: SnakeState, params: SnakeParams) -> bool:
    """Whether some mode can be executed in this state without a violation."""
    modes = mode_table(params.n_joints).valid(state.phase)
    return bool(np.any(predict(state, modes, params).feasible))
