"""The instant mask, (22) at t_k for all modes of a state at once: a block of states at a time.

Modes that lift the same front wheels share the first part of :func:`statically_stable`'s walk over the
contacts, and the trace keeps each common operation once. So all 99 modes of a robot with 8 joints cost
hardly more than one sub-step of one mode.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

from snake_env.equations.kinematics import locate
from snake_env.equations.scalars import Bool, Scalar, both, either, negate, select
from snake_env.equations.stability import statically_stable
from snake_env.kernel.lane_function import LaneFunction
from snake_env.modes import mode_table
from snake_env.params import SnakeParams

MAX_MODES = 256
"""With more modes the program grows too large; then the modes are tested one by one."""


def instant_marks(p: SnakeParams, phi: Sequence[Scalar], phase: Scalar) -> list[Scalar]:
    """1 for each mode that the phase allows and that is stable at t_k, else 0.

    Where no mode is stable, what the phase allows.

    Args:
        p: The constants.
        phi: Joint angles, n values [rad].
        phase: The SCP's number; n + 1: the target is reached.
    """
    table, n = mode_table(len(phi)), len(phi)
    body = locate(phi, p.l)
    on_ground = [either(phase < float(k), phase > float(k)) for k in range(1, n + 1)]
    allowed: list[Bool] = []
    stable: list[Bool] = []
    for lifted in table.lifted.tolist():
        foremost = lifted.index(True) + 1 if any(lifted) else n + 1
        grounded = [both(not up, on) for up, on in zip(lifted, on_ground, strict=True)]
        allowed.append(phase < float(foremost))
        stable.append(both(allowed[-1], statically_stable(body, grounded, p)))
    none = negate(functools.reduce(either, stable))
    return [
        select(either(is_stable, both(none, is_allowed)), 1.0, 0.0)
        for is_stable, is_allowed in zip(stable, allowed, strict=True)
    ]


@functools.cache
def get_mask_kernel(n_joints: int, head_contact: bool) -> LaneFunction:
    """The shared mask kernel for these sizes, compiled or loaded from the cache on first use."""
    what = f"the masks of {n_joints} joints"
    return LaneFunction(instant_marks, (n_joints, 1), head_contact, what)
