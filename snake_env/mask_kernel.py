"""(22) at t_k for all modes of a state at once: eight states a block.

Modes that lift the same front wheels share the first part of :func:`statically_stable`'s walk over the
contacts, and the trace keeps each common operation once. So all 99 modes of a robot with 8 joints cost
hardly more than one sub-step of one mode.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from snake_env.blocks import LANES, BlockProgram, clock_of, constants_of, traced_params
from snake_env.kinematics import locate
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.scalars import Bool, both, select
from snake_env.stability import statically_stable
from snake_env.state import StateBatch
from snake_env.tracing import Trace

MAX_MODES = 256
"""With more modes the program grows too large; then the modes are tested one by one."""


class MaskKernel(BlockProgram):
    """Tests (22) for every mode; rows: joint angles, the phase, then a 1 or 0 for each mode."""

    def __init__(self, n_joints: int, head_contact: bool) -> None:
        table = mode_table(n_joints)
        trace = Trace()
        p = traced_params(trace, head_contact)
        body = locate([trace.lane(row) for row in range(n_joints)], p.l)
        phase = trace.lane(n_joints)
        on_ground: list[Bool] = [
            (phase < float(k)) | (phase > float(k)) for k in range(1, n_joints + 1)
        ]  # all but the SCP's wheel
        for mode, lifted in enumerate(table.lifted.tolist()):
            grounded = [both(not up, on) for up, on in zip(lifted, on_ground, strict=True)]
            stable = statically_stable(body, grounded, p)
            trace.store(n_joints + 1 + mode, select(stable, 1.0, 0.0))
        rows = n_joints + 1 + len(table)
        super().__init__(Trace(), trace, rows, 0, LANES, f"the masks of {n_joints} joints")


@functools.cache
def get_mask_kernel(n_joints: int, head_contact: bool) -> MaskKernel:
    """The shared mask kernel for these sizes, compiled or loaded from the cache on first use."""
    return MaskKernel(n_joints, head_contact)


def stable_modes(states: StateBatch, params: SnakeParams) -> NDArray[np.bool_]:
    """Whether (22) holds at t_k for each state and each mode, valid in its phase or not.

    Args:
        states: N states.
        params: The constants; at most :data:`MAX_MODES` modes.

    Returns:
        Shape (N, n_modes).
    """
    n, count = params.n_joints, len(states)
    kernel = get_mask_kernel(n, params.head_contact)
    blocks = kernel.blocks(count)
    lanes = np.zeros((n + 1, len(blocks) * kernel.lanes))
    lanes[:n, :count] = states.phi.T
    lanes[n, :count] = states.phase
    blocks[:, : n + 1] = lanes.reshape(n + 1, -1, kernel.lanes).transpose(1, 0, 2)
    kernel.run(blocks, constants_of(params), clock_of(params)[:0])
    stable = blocks[:, n + 1 :] == 1.0
    return np.ascontiguousarray(stable.transpose(0, 2, 1)).reshape(-1, stable.shape[1])[:count]
