"""One interval of the hybrid system (3)-(4): ``predict`` it, ``advance`` through it.

Everything here goes through the one kernel, for one state or many.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from snake_env.equations.control import redundancy_gain
from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.kernel import distance
from snake_env.kernel.blocks import clock_of, constants_of
from snake_env.kernel.interval import (
    BEYOND_LIMIT,
    PADDING,
    RUNNING,
    UNSTABLE,
    get_cost_program,
    get_kernel,
)
from snake_env.modes import mode_table
from snake_env.params import LARGEST, SnakeParams
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch, read_only, remade

VIOLATIONS = ("", "stability", "joint_limit")
"""Names of what can go wrong in an interval: nothing, (22), (23)."""

_NAMES = np.array(VIOLATIONS)
_REAL_FIELDS = ("w", "phi", "target", "phase_time", "ref_start", "elapsed", "last_turn")
assert (RUNNING, UNSTABLE, BEYOND_LIMIT) == (0, 1, 2)  # they index VIOLATIONS


@dataclass(frozen=True, eq=False)
class Prediction:
    """What M lanes (a state with a mode each) do in one interval.

    A lane stops at its first violation: its fields then tell of the time up to there.

    Attributes:
        phi: Joint angles at the end, shape (M, n) [rad].
        w: Head pose at the end, shape (M, 3) [m, m, rad].
        cost: Integral of V, shape (M,) [s].
        j: J of (24), shape (M,); infinite where infeasible.
        feasible: Whether (22) and (23) hold throughout, shape (M,).
        violation: Name of the first violation, shape (M,): ``""``, ``"stability"`` or
            ``"joint_limit"``.
        d_min: Least distance between links that could collide, shape (M,) [m].
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

    def take(self, indices: IntArray) -> Prediction:
        """The lanes at the given positions."""
        fields = dataclasses.fields(self)
        return Prediction(**{field.name: getattr(self, field.name)[indices] for field in fields})


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
    return predict_batch(*_with_each(state, modes), params)


def final_blocks(state: SnakeState, modes: ArrayLike, params: SnakeParams) -> FloatArray:
    """What :func:`predict` makes predictions of: the kernel's blocks at the end of the interval.

    Returns:
        Shape (n_blocks, n_rows, n_lanes), as :class:`snake_env.kernel.interval.Kernel` lays them out;
        a lane for each mode, then padding.
    """
    states, chosen = _with_each(state, modes)
    _check_states(states, chosen, params)
    return _run_blocks(states, chosen, params, clock_of(params))


def _with_each(state: SnakeState, modes: ArrayLike) -> tuple[StateBatch, IntArray]:
    """One state for each of some modes."""
    chosen = _checked_modes(modes)
    return StateBatch.stack([state]).take(np.zeros(len(chosen), dtype=np.intp)), chosen


def predict_batch(states: StateBatch, modes: ArrayLike, params: SnakeParams) -> Prediction:
    """Predicts one interval of many states, with one mode each.

    Args:
        states: N states at their t_k.
        modes: One mode index per state, shape (N,).
        params: The constants.

    Raises:
        InvalidModeError: A mode is out of range or not valid in its state's phase.
        InvalidInputError: The states do not fit the constants or the modes.
    """
    chosen = _checked_modes(modes)
    _check_states(states, chosen, params)
    outcome = _run(states, chosen, params, clock_of(params))
    scp = states.phase - 1
    lanes = np.arange(len(chosen))
    turned = np.abs(outcome["phi"][lanes, scp] - states.phi[lanes, scp])
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
    chosen = _checked_modes(modes)
    _check_states(states, chosen, params)
    outcome = _run(states, chosen, params, clock_of(params)[:0])
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


def trajectories(states: StateBatch, modes: ArrayLike, params: SnakeParams) -> list[Trajectory]:
    """The motion of many states through one interval, with one mode each, sub-step by sub-step."""
    chosen = _checked_modes(modes)
    _check_states(states, chosen, params)
    clock = clock_of(params)
    n_steps = len(clock)
    now = states
    phi, w, u = [states.phi], [states.w], []
    running = np.zeros((len(chosen), n_steps), dtype=np.bool_)
    ended = np.zeros(len(chosen), dtype=np.bool_)
    for step in range(n_steps):
        outcome = _run(now, chosen, params, clock[step : step + 1])
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
    states, chosen = _checked_lane(state, mode, params)
    now = np.array([[float(t), redundancy_gain(float(t), params)]])
    u: FloatArray = _run(states, chosen, params, now)["u"][0]
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
    states, chosen = _checked_lane(state, mode, params)
    grounded = ~mode_table(params.n_joints).lifted_wheels(chosen, states.phase)[0]
    program = get_cost_program(params.n_joints)
    values = program.of_one(params, (state.phi, float(state.phase), grounded), np.float64)
    return float(values[0]), values[1:]


def _checked_lane(state: SnakeState, mode: int, params: SnakeParams) -> tuple[StateBatch, IntArray]:
    """A state with a mode as a batch, known to belong together."""
    states = StateBatch.stack([state])
    chosen = np.array([mode_table(params.n_joints).check(mode, state.phase)])
    _check_states(states, chosen, params)
    return states, chosen


def _checked_modes(modes: ArrayLike) -> IntArray:
    array = np.asarray(modes)
    if array.ndim != 1:
        raise InvalidInputError("modes.shape", array.shape, "one dimension")
    if len(array) and array.dtype.kind not in "iu":
        raise InvalidModeError("modes", array.tolist(), "integers")
    return array.astype(np.int64)


def check_states(states: StateBatch, params: SnakeParams) -> None:
    """Raises InvalidInputError where states can't be those of a robot with these constants."""
    n = params.n_joints
    for name, length in (("phi", n), ("target", n), ("w", 3)):
        shape = getattr(states, name).shape
        if len(shape) != 2 or shape[1] != length:
            expected = "3 numbers" if name == "w" else f"n_joints = {n} joint angles"
            found = shape[1] if len(shape) == 2 else shape[1:]
            raise InvalidInputError(f"state.{name}", found, expected)
    numbers = {name: getattr(states, name).ravel() for name in _REAL_FIELDS}
    sizes = np.abs(np.concatenate(tuple(numbers.values())))  # all at once: it is quicker
    if not (sizes <= LARGEST).all():
        for name, values in numbers.items():
            for wrong in values[~(np.abs(values) <= LARGEST)]:
                expected = f"finite numbers, at most {LARGEST:g} in size"
                raise InvalidInputError(f"state.{name}", float(wrong), expected)
    if len(states) and (states.phase.min() < 1 or states.phase.max() > n + 1):
        raise InvalidInputError("state.phase", states.phase.tolist(), f"1 to {n + 1}")
    if len(states) and not -1 <= states.last_mode.min() <= states.last_mode.max() < len(
        mode_table(n)
    ):
        raise InvalidInputError("state.last_mode", states.last_mode.tolist(), "mode indices or -1")


def _check_states(states: StateBatch, modes: IntArray, params: SnakeParams) -> None:
    """Raises where states, modes and constants do not belong together."""
    if len(modes) != len(states):
        raise InvalidInputError("modes", len(modes), f"one mode for each of {len(states)} states")
    if len(states) == 0:
        return
    check_states(states, params)
    table = mode_table(params.n_joints)
    in_range = (modes >= 0) & (modes < len(table))
    valid = (
        in_range & table.masks(states.phase)[np.arange(len(modes)), np.where(in_range, modes, 0)]
    )
    if not valid.all():
        first = int(np.argmin(valid))
        table.check(int(modes[first]), int(states.phase[first]))


def _run(
    states: StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> dict[str, FloatArray]:
    """Runs the kernel over states with a mode each; what each lane ends with, by field."""
    return _outcome(_run_blocks(states, modes, params, clock), len(modes), params)


def _run_blocks(
    states: StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> FloatArray:
    """Runs the kernel over states with a mode each; its blocks, as it left them."""
    table = mode_table(params.n_joints)
    kernel = get_kernel(params.n_joints, params.head_contact)
    at, count = kernel.rows, len(modes)
    blocks = kernel.blocks(count)
    lanes = np.zeros((kernel.n_rows, len(blocks) * kernel.lanes))
    each, scp = np.arange(count), states.phase - 1
    grounded = ~table.lifted_wheels(modes, states.phase)
    lanes[at["violation"], count:] = PADDING
    lanes[at["d2_min"]] = np.inf
    lanes[at["phi"], :count] = states.phi.T
    lanes[at["w"], :count] = states.w.T
    lanes[at["max_abs_phi"], :count] = np.abs(states.phi).max(axis=1, initial=0.0)
    lanes[at["phase"], :count] = states.phase
    lanes[at["target"], :count] = states.target[each, scp]
    lanes[at["ref_start"], :count] = states.ref_start
    lanes[at["phase_time"], :count] = states.phase_time
    lanes[at["grounded"], :count] = grounded.T
    lanes[at["wheels"], :count] = table.wheels[modes].T
    blocks[:] = lanes.reshape(kernel.n_rows, len(blocks), kernel.lanes).transpose(1, 0, 2)
    kernel.run(blocks, constants_of(params), clock)
    return blocks


def _outcome(blocks: FloatArray, count: int, params: SnakeParams) -> dict[str, FloatArray]:
    """What each lane ends with, by field."""
    kernel = get_kernel(params.n_joints, params.head_contact)
    at = kernel.rows
    lanes = blocks.transpose(1, 0, 2).reshape(kernel.n_rows, -1)[:, :count]
    outputs = ("phi", "w", "u", "integral", "duration", "violation", "d2_min", "max_abs_phi")
    return {name: np.ascontiguousarray(lanes[at[name]].T) for name in outputs}
