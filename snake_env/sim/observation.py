"""What an agent sees: a flat, normalised vector, for one state or many."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.features import SUPPORT_DIRECTIONS, features
from snake_env.equations.scalars import Scalar
from snake_env.kernel.lane_function import LaneFunction
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.lanes import check_state, check_states
from snake_env.sim.masks import instant_mask
from snake_env.state import FloatArray, SnakeState, StateBatch


def observation_rows(n_joints: int) -> list[tuple[str, int]]:
    """Names of the observation's blocks and how many values each has, in order."""
    n = n_joints
    return [
        ("phi", n),
        ("target", n),
        ("error", n),
        ("limit_margin", n),
        ("phase", n + 1),
        ("scp_error", 1),
        ("ref_start", 1),
        ("cam_progress", 1),
        ("phase_time", 1),
        ("last_lifted", n),
        ("last_turn", 1),
        ("head_error", 3),
        ("link_direction", 2 * n),
        ("link_centre", 2 * n),
        ("centre_of_gravity", 2),
        ("support_margin", SUPPORT_DIRECTIONS),
    ]


def observation_size(n_joints: int) -> int:
    """Values in an observation."""
    return sum(size for _, size in observation_rows(n_joints))


def observe(states: SnakeState | StateBatch, params: SnakeParams) -> NDArray[np.float32]:
    """The observation of a state, or those of many: each value within [-1, 1].

    Args:
        states: A state, or N of them.
        params: The constants.

    Returns:
        Shape (observation_size,) or (N, observation_size), float32, freshly allocated. The rows are
        described in :class:`snake_env.envs.env.SnakeModeSelectionEnv`.

    Raises:
        InvalidInputError: A state does not fit the constants.
    """
    if isinstance(states, SnakeState):
        check_state(states, params)
    else:
        check_states(states, params)
    return observe_unchecked(states, params)


def observe_unchecked(states: SnakeState | StateBatch, params: SnakeParams) -> NDArray[np.float32]:
    """:func:`observe` for states that are known to fit the constants."""
    kernel = get_observation_kernel(params.n_joints, params.head_contact)
    if isinstance(states, SnakeState):
        return kernel.of_one(params, _arguments(states, params), np.float32)
    return kernel.of_many(params, _arguments(states, params), np.float32)


def observation_and_mask(
    state: SnakeState, params: SnakeParams
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """All that a learned policy needs for a decision, in some microseconds.

    Args:
        state: The robot at t_k.
        params: The constants.

    Returns:
        The observation, shape (observation_size,), and the instant mask, shape (n_modes,): bit for bit
        what :func:`observe` and :func:`snake_env.sim.masks.action_masks` give for it.

    Raises:
        InvalidInputError: The state does not fit the constants.
    """
    check_state(state, params)
    return observe_unchecked(state, params), instant_mask(state, params)


def _arguments(state: SnakeState | StateBatch, params: SnakeParams) -> tuple[Any, ...]:
    """What :func:`features` needs, of one state or of many."""
    return (
        *(state.phi, state.target, state.w, state.phase, state.phase_time, state.ref_start),
        *(state.last_turn, _lifted_before(params.n_joints)[state.last_mode + 1]),
    )


@functools.cache
def _lifted_before(n_joints: int) -> FloatArray:
    """The rear wheels that each mode lifts; no mode, -1, comes first: shape (1 + n_modes, n)."""
    lifted = np.insert(mode_table(n_joints).lifted.astype(np.float64), 0, 0.0, axis=0)
    lifted.setflags(write=False)
    return lifted


@functools.cache
def get_observation_kernel(n_joints: int, head_contact: bool) -> LaneFunction:
    """The shared program for these sizes, compiled or loaded from the cache on first use."""
    n = n_joints

    def observation(p: SnakeParams, *arguments: Any) -> list[Scalar]:
        return [value for values in features(p, *arguments).values() for value in values]

    lengths = (n, n, 3, 1, 1, 1, 1, n)  # of what _arguments gives
    return LaneFunction(observation, lengths, head_contact, f"the observation of {n} joints")
