"""States and modes as lanes of the kernel: checked, laid out in blocks, run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.kernel.blocks import block_width, clock_of, constants_of
from snake_env.kernel.interval import PADDING, get_kernel, layout
from snake_env.modes import mode_table
from snake_env.params import LARGEST, SnakeParams
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch

_REAL_FIELDS = ("w", "phi", "target", "phase_time", "ref_start", "elapsed", "last_turn")


def final_blocks(state: SnakeState, modes: ArrayLike, params: SnakeParams) -> FloatArray:
    """What :func:`predict` makes predictions of: the kernel's blocks at the end of the interval.

    Returns:
        Shape (n_blocks, n_rows, n_lanes), as :class:`snake_env.kernel.interval.Kernel` lays them out;
        a lane for each mode, then padding.
    """
    return run_blocks(state, checked_for(state, modes, params), params, clock_of(params))


def checked_for(state: SnakeState, modes: ArrayLike, params: SnakeParams) -> IntArray:
    """Modes as an array, shape (M,), each of which is known to be possible in a state.

    Raises:
        InvalidModeError: A mode is out of range or not valid in the phase.
        InvalidInputError: The state does not fit the constants, or the modes are no list.
    """
    chosen, table = checked_modes(modes), mode_table(params.n_joints)
    check_state(state, params)
    if not table.valid_pairs(chosen, np.int64(state.phase)).all():
        for mode in chosen:
            table.check(int(mode), state.phase)
    return chosen


def check_state(state: SnakeState, params: SnakeParams) -> None:
    """Raises InvalidInputError where a state can't be that of a robot with these constants."""
    if not _is_sound(state, params):
        check_states(StateBatch.stack([state]), params)


def check_running(state: SnakeState) -> None:
    """Raises InvalidInputError where a state has reached its target: there is no mode to choose."""
    if state.done:
        raise InvalidInputError("state.phase", state.phase, f"1 to {len(state.phi)}")


def _is_sound(state: SnakeState, params: SnakeParams) -> bool:
    """Whether a state is sure to pass :func:`check_states`: this is quicker than to ask that."""
    n, w, phi, target = params.n_joints, state.w, state.phi, state.target
    a, b, c, d = state.phase_time, state.ref_start, state.elapsed, state.last_turn
    return (
        w.shape == (3,)
        and phi.shape == target.shape == (n,)
        and type(a) is type(b) is type(c) is type(d) is float
        and math.hypot(*w.tolist(), *phi.tolist(), *target.tolist(), a, b, c, d) <= LARGEST
        and type(state.phase) is type(state.last_mode) is int
        and 1 <= state.phase <= n + 1
        and -1 <= state.last_mode < len(mode_table(n))
    )


def checked_mode(state: SnakeState, mode: int, params: SnakeParams) -> IntArray:
    """:func:`checked_for` a single mode, shape (1,)."""
    chosen = mode_table(params.n_joints).check(mode, state.phase)
    return checked_for(state, [chosen], params)


def checked_modes(modes: ArrayLike) -> IntArray:
    """Mode indices as an array, shape (N,): not yet compared with phases.

    Raises:
        InvalidInputError: They have more dimensions than one, or none.
        InvalidModeError: They are no integers.
    """
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
    numbers = [getattr(states, name) for name in _REAL_FIELDS]
    sizes = np.abs(np.concatenate(numbers, axis=None))  # all at once: it is quicker
    if not (sizes <= LARGEST).all():
        for name, values in zip(_REAL_FIELDS, numbers, strict=True):
            for wrong in values[~(np.abs(values) <= LARGEST)]:
                expected = f"finite numbers, at most {LARGEST:g} in size"
                raise InvalidInputError(f"state.{name}", float(wrong), expected)
    if ((states.phase < 1) | (states.phase > n + 1)).any():
        raise InvalidInputError("state.phase", states.phase.tolist(), f"1 to {n + 1}")
    if ((states.last_mode < -1) | (states.last_mode >= len(mode_table(n)))).any():
        raise InvalidInputError("state.last_mode", states.last_mode.tolist(), "mode indices or -1")


def check_pairs(states: StateBatch, modes: IntArray, params: SnakeParams) -> None:
    """Raises where states, modes and constants do not belong together."""
    if len(modes) != len(states):
        raise InvalidInputError("modes", len(modes), f"one mode for each of {len(states)} states")
    if len(modes) == 0:
        return
    check_states(states, params)
    table = mode_table(params.n_joints)
    if not table.valid_pairs(modes, states.phase).all():
        for mode, phase in zip(modes, states.phase, strict=True):
            table.check(int(mode), int(phase))


def run_lanes(
    states: SnakeState | StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> dict[str, FloatArray]:
    """Runs the kernel as :func:`run_blocks` does; what each lane ends with, by field."""
    return _outcome(run_blocks(states, modes, params, clock), len(modes), params)


def run_blocks(
    states: SnakeState | StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> FloatArray:
    """Runs the kernel over states with a mode each, or one state with all modes; its blocks."""
    count = len(modes)
    kernel = get_kernel(params.n_joints, params.head_contact, block_width(count))
    blocks = kernel.blocks(count)
    if isinstance(states, SnakeState):
        _fill_with_one(blocks, kernel.rows, states, modes)
    else:
        _fill_with_many(blocks, kernel.rows, states, modes)
    kernel.run(blocks, constants_of(params), clock)
    return blocks


def _fill_with_one(
    blocks: FloatArray, at: dict[str, slice], state: SnakeState, modes: IntArray
) -> None:
    """Writes one state with all modes: what the lanes share goes to all of them at once."""
    n_blocks, n_rows, n_lanes = blocks.shape
    if n_blocks == 0:
        return
    shared = np.zeros(n_rows)
    shared[at["phi"]] = state.phi
    shared[at["w"]] = state.w
    shared[at["d2_min"]] = np.inf
    shared[at["max_abs_phi"]] = np.abs(state.phi).max()
    shared[at["phase"]] = state.phase
    shared[at["target"]] = state.target[state.phase - 1]
    shared[at["ref_start"]] = state.ref_start
    shared[at["phase_time"]] = state.phase_time
    blocks[:] = shared[:, None]
    by_lane = np.zeros(n_blocks * n_lanes, dtype=np.int64)
    by_lane[: len(modes)] = modes
    blocks[-1, at["violation"], len(modes) - (n_blocks - 1) * n_lanes :] = PADDING
    by_block, table = by_lane.reshape(n_blocks, n_lanes), mode_table(len(state.phi))
    grounded = ~table.lifted_wheels(by_block, np.int64(state.phase))
    blocks[:, at["grounded"]] = grounded.transpose(0, 2, 1)
    blocks[:, at["wheels"]] = table.wheels[by_block].transpose(0, 2, 1)


def _fill_with_many(
    blocks: FloatArray, at: dict[str, slice], states: StateBatch, modes: IntArray
) -> None:
    """Writes states with a mode each."""
    n_blocks, n_rows, n_lanes = blocks.shape
    table, count = mode_table(states.phi.shape[1]), len(modes)
    lanes = np.zeros((n_rows, n_blocks * n_lanes))
    each, scp = np.arange(count), states.phase - 1
    lanes[at["violation"], count:] = PADDING
    lanes[at["d2_min"]] = np.inf
    lanes[at["phi"], :count] = states.phi.T
    lanes[at["w"], :count] = states.w.T
    lanes[at["max_abs_phi"], :count] = np.abs(states.phi).max(axis=1, initial=0.0)
    lanes[at["phase"], :count] = states.phase
    lanes[at["target"], :count] = states.target[each, scp]
    lanes[at["ref_start"], :count] = states.ref_start
    lanes[at["phase_time"], :count] = states.phase_time
    lanes[at["grounded"], :count] = ~table.lifted_wheels(modes, states.phase).T
    lanes[at["wheels"], :count] = table.wheels[modes].T
    blocks[:] = lanes.reshape(n_rows, n_blocks, n_lanes).transpose(1, 0, 2)


def _outcome(blocks: FloatArray, count: int, params: SnakeParams) -> dict[str, FloatArray]:
    """What each lane ends with, by field."""
    at = layout(params.n_joints)
    lanes = blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)[:, :count]
    outputs = ("phi", "w", "u", "integral", "duration", "violation", "d2_min", "max_abs_phi")
    return {name: np.ascontiguousarray(lanes[at[name]].T) for name in outputs}
