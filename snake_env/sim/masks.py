"""Which modes may be chosen: the masks ``structural``, ``instant`` and ``lookahead``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import UnknownNameError
from snake_env.kernel.instant_mask import MAX_MODES, get_mask_kernel
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.lanes import check_state
from snake_env.sim.simulation import instantly_stable, predict_batch
from snake_env.state import IntArray, SnakeState, StateBatch

MaskLevel = Literal["structural", "instant", "lookahead"]


def check_mask_level(level: str) -> None:
    """Raises UnknownNameError unless ``level`` is a mask level."""
    if level not in get_args(MaskLevel):
        raise UnknownNameError("mask level", level, get_args(MaskLevel))


def action_masks(
    states: StateBatch, params: SnakeParams, level: MaskLevel = "instant"
) -> NDArray[np.bool_]:
    """Masks of many states.

    Args:
        states: N states.
        params: The constants.
        level: ``structural``: what the phase allows. ``instant``: and (22) holds at t_k, which costs
            no roll-out. ``lookahead``: and (22), (23) hold throughout the interval: as many
            roll-outs as (21).

    Returns:
        Shape (N, n_modes). Where a level would leave nothing to choose, what the level before it
        allows; all False for states that have reached their target.

    Raises:
        UnknownNameError: No such level.
    """
    check_mask_level(level)
    table = mode_table(params.n_joints)
    if level == "structural":
        return table.masks(states.phase).copy()
    instant: NDArray[np.bool_]
    if len(table) > MAX_MODES:
        structural = table.masks(states.phase)
        instant = _or_else(_each(structural, states, params, instantly_stable), structural)
    else:
        kernel = get_mask_kernel(params.n_joints, params.head_contact)
        instant = kernel.of_many(params, (states.phi, states.phase), np.bool_)
    if level == "instant":
        return instant
    feasible = _each(instant, states, params, lambda *pair: predict_batch(*pair).feasible)
    return _or_else(feasible, instant)


def action_mask(
    state: SnakeState, params: SnakeParams, level: MaskLevel = "instant"
) -> NDArray[np.bool_]:
    """The mask of one state: which modes are allowed.

    Args:
        state: The robot at t_k.
        params: The constants.
        level: How strict it is, see :func:`action_masks`.

    Returns:
        Shape (n_modes,).

    Raises:
        UnknownNameError: No such level.
        InvalidInputError: The state does not fit the constants.
    """
    check_state(state, params)
    if level == "instant":
        return instant_mask(state, params)
    mask: NDArray[np.bool_] = action_masks(StateBatch.stack([state]), params, level)[0]
    return mask


def instant_mask(state: SnakeState, params: SnakeParams) -> NDArray[np.bool_]:
    """The mask ``instant`` of a state that fits the constants, in some microseconds: (n_modes,)."""
    mask: NDArray[np.bool_]
    if len(mode_table(params.n_joints)) > MAX_MODES:
        mask = action_masks(StateBatch.stack([state]), params, "instant")[0]
    else:
        kernel = get_mask_kernel(params.n_joints, params.head_contact)
        mask = kernel.of_one(params, (state.phi, state.phase), np.bool_)
    return mask


def _each(
    mask: NDArray[np.bool_],
    states: StateBatch,
    params: SnakeParams,
    test: Callable[[StateBatch, IntArray, SnakeParams], NDArray[np.bool_]],
) -> NDArray[np.bool_]:
    """The marked pairs of a state and a mode that pass a test."""
    rows, modes = np.nonzero(mask)
    passed = np.zeros_like(mask)
    passed[rows, modes] = test(states.take(rows), modes, params)
    return passed


def _or_else(mask: NDArray[np.bool_], fallback: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask, but the fallback where nothing is left."""
    result: NDArray[np.bool_] = np.where(mask.any(axis=1, keepdims=True), mask, fallback)
    return result
