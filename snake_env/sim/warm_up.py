"""Loads the compiled programs before the work begins."""

from __future__ import annotations

from snake_env.kernel.blocks import block_widths
from snake_env.kernel.distance import get_distance_program
from snake_env.kernel.instant_mask import MAX_MODES, get_mask_kernel
from snake_env.kernel.interval import get_kernel
from snake_env.modes import mode_table
from snake_env.params import SnakeParams


def warm_up(params: SnakeParams) -> None:
    """Compiles or loads the code that predictions and masks need; learned policies load their own."""
    sizes = params.n_joints, params.head_contact
    get_distance_program(params.n_joints)
    for lanes in block_widths():
        get_kernel(*sizes, lanes)
    if len(mode_table(params.n_joints)) <= MAX_MODES:
        get_mask_kernel(*sizes)
