"""Which modes may be chosen: the masks ``structural``, ``instant`` and ``lookahead``."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import UnknownNameError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.simulation import instantly_stable, predict_batch
from snake_env.state import StateBatch

MaskLevel = Literal["structural", "instant", "lookahead"]


def check_mask_level(level: str) -> None:
    """Raises UnknownNameError unless ``level`` is a mask level."""
    if level not in get_args(MaskLevel):
        raise UnknownNameError("mask level", level, get_args(MaskLevel))


def action_masks(states: StateBatch, level: MaskLevel, params: SnakeParams) -> NDArray[np.bool_]:
    """Masks of many states.

    Args:
        states: N states.
        level: ``structural``: what the phase allows. ``instant``: and (22) holds at t_k, which costs
            no roll-out. ``lookahead``: and (22), (23) hold throughout the interval: as many
            roll-outs as (21).
        params: The constants.

    Returns:
        Shape (N, n_modes). Where a level would leave nothing to choose, what the level before it
        allows; all False for states that have reached their target.

    Raises:
        UnknownNameError: No such level.
    """
    check_mask_level(level)
    structural: NDArray[np.bool_] = mode_table(params.n_joints).masks(states.phase)
    if level == "structural":
        return structural.copy()
    mask = _narrowed(structural, states, params, lookahead=False)
    return mask if level == "instant" else _narrowed(mask, states, params, lookahead=True)


def _narrowed(
    mask: NDArray[np.bool_], states: StateBatch, params: SnakeParams, *, lookahead: bool
) -> NDArray[np.bool_]:
    rows, modes = np.nonzero(mask)
    pairs = states.take(rows)
    allowed = (
        predict_batch(pairs, modes, params).feasible
        if lookahead
        else instantly_stable(pairs, modes, params)
    )
    narrowed = np.zeros_like(mask)
    narrowed[rows[allowed], modes[allowed]] = True
    nothing_left = ~narrowed.any(axis=1)
    narrowed[nothing_left] = mask[nothing_left]
    return narrowed
