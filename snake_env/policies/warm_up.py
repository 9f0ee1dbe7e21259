"""The compiled programs, all together."""

from __future__ import annotations

from snake_env.kernel.distance import get_distance_program
from snake_env.kernel.instant_mask import MAX_MODES, get_mask_kernel
from snake_env.kernel.interval import get_kernel
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.ends import get_ends_program
from snake_env.sim.observation import get_observation_kernel


def warm_up(params: SnakeParams) -> None:
    """Compiles or loads all the code that predictions, masks and observations need."""
    sizes = params.n_joints, params.head_contact
    get_distance_program(params.n_joints)
    get_kernel(*sizes)
    get_observation_kernel(*sizes)
    get_ends_program(*sizes)
    if len(mode_table(params.n_joints)) <= MAX_MODES:
        get_mask_kernel(*sizes)
