"""States and modes as lanes of the kernel: checked, laid out in blocks, run."""

from __future__ import annotations

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
    states, chosen = checked_state(state, modes, params)
    return run_blocks(states, chosen, params, clock_of(params))


def checked_state(
    state: SnakeState, modes: ArrayLike, params: SnakeParams
) -> tuple[StateBatch, IntArray]:
    """A state as a batch of one, and modes, known to belong together."""
    states, chosen = StateBatch.stack([state]), checked_modes(modes)
    _check_modes(states, chosen, params)
    return states, chosen


def checked_lane(state: SnakeState, mode: int, params: SnakeParams) -> tuple[StateBatch, IntArray]:
    """A state with a mode as a batch, known to belong together."""
    states = StateBatch.stack([state])
    chosen = np.array([mode_table(params.n_joints).check(mode, state.phase)])
    check_pairs(states, chosen, params)
    return states, chosen


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
    _check_modes(states, modes, params)


def _check_modes(states: StateBatch, modes: IntArray, params: SnakeParams) -> None:
    """Raises where a state, or a mode in its state, does not fit the constants."""
    if len(modes) == 0:
        return
    check_states(states, params)
    table = mode_table(params.n_joints)
    if not table.valid_pairs(modes, states.phase).all():
        for mode, phase in np.broadcast(modes, states.phase):
            table.check(int(mode), int(phase))


def run_lanes(
    states: StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> dict[str, FloatArray]:
    """Runs the kernel as :func:`run_blocks` does; what each lane ends with, by field."""
    return _outcome(run_blocks(states, modes, params, clock), len(modes), params)


def run_blocks(
    states: StateBatch, modes: IntArray, params: SnakeParams, clock: FloatArray
) -> FloatArray:
    """Runs the kernel over states with a mode each, or one state with all modes; its blocks."""
    table, count = mode_table(params.n_joints), len(modes)
    kernel = get_kernel(params.n_joints, params.head_contact, block_width(count))
    at = kernel.rows
    blocks = kernel.blocks(count)
    lanes = np.zeros((kernel.n_rows, len(blocks) * kernel.lanes))
    each, scp = np.arange(len(states)), states.phase - 1
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
    at = layout(params.n_joints)
    lanes = blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)[:, :count]
    outputs = ("phi", "w", "u", "integral", "duration", "violation", "d2_min", "max_abs_phi")
    return {name: np.ascontiguousarray(lanes[at[name]].T) for name in outputs}
