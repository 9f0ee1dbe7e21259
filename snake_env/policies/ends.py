"""What an agent would see where modes lead: one state's modes, predicted and observed in one go.

The policy ``value`` predicts as (21) does and asks a network about every end. Most of its extra time
over (21) went into building states in between, so this module skips them.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.features import features
from snake_env.equations.scalars import Scalar, absolute, both, maximum, negate, select
from snake_env.kernel.blocks import constants_of
from snake_env.kernel.interval import RUNNING, Kernel, get_kernel, layout
from snake_env.kernel.lane_function import LaneFunction
from snake_env.params import SnakeParams
from snake_env.sim.lanes import final_blocks
from snake_env.state import FloatArray, IntArray, SnakeState


@dataclass(frozen=True, eq=False)
class Ends:
    """Where M modes lead from one state.

    Attributes:
        executable: Which are feasible and let no links touch, shape (M,).
        reached: Which reach the target, shape (M,).
        turn: How far the joint that turns most has turned at the end, shape (M,) [rad].
        observations: What an agent would see there, shape (M, observation_size); of no use where the
            mode is infeasible.
    """

    executable: NDArray[np.bool_]
    reached: NDArray[np.bool_]
    turn: NDArray[np.float32]
    observations: NDArray[np.float32]


def ends(state: SnakeState, modes: IntArray, params: SnakeParams) -> Ends:
    """Predicts one interval for each mode and observes where it ends.

    Args:
        state: The robot at t_k.
        modes: Mode indices, shape (M,), each valid in the state's phase; repeats are allowed.
        params: The constants.

    Returns:
        To the bit what :func:`snake_env.policies.search.expand` keeps, and what
        :func:`snake_env.sim.observation.observe` gives for that.

    Raises:
        InvalidModeError: A mode is out of range or not valid in the phase.
        InvalidInputError: The state does not fit the constants.
    """
    blocks, count = final_blocks(state, modes, params), len(modes)
    program = get_ends_program(params.n_joints, params.head_contact, blocks.shape[2])
    at = layout(params.n_joints)
    violation, d2_min = (
        blocks[:, at[name].start].reshape(-1)[:count] for name in ("violation", "d2_min")
    )
    results = program(blocks, state, params)[:count]
    return Ends(
        executable=(violation == RUNNING) & (np.sqrt(d2_min) >= params.d_touch),
        reached=results[:, 0] > params.n_joints,
        turn=results[:, 1],
        observations=results[:, 2:],
    )


class EndsProgram(LaneFunction):
    """From lanes at the end of an interval, as the kernel leaves them, to observations.

    Args:
        n_joints: Joints of the robots.
        head_contact: That of the constants.
        lanes: Lanes of a block, as the kernel left them.
    """

    def __init__(self, n_joints: int, head_contact: bool, lanes: int) -> None:
        kernel, n = get_kernel(n_joints, head_contact, lanes), n_joints
        lengths = (kernel.n_rows, n, n)  # the lane, its target, its shape before the interval
        what = f"the ends of {n} joints"
        super().__init__(functools.partial(_observed, kernel), lengths, head_contact, what, lanes)
        self._lane, self._target, self._before = self.rows

    def __call__(
        self, lanes: FloatArray, state: SnakeState, params: SnakeParams
    ) -> NDArray[np.float32]:
        """Phase, largest turn and observation at each end, shape (M, 2 + observation_size)."""
        blocks = self.blocks(len(lanes) * self.lanes)
        blocks[:, self._lane] = lanes
        blocks[:, self._target] = state.target[:, None]
        blocks[:, self._before] = state.phi[:, None]
        if len(blocks):
            self.bind(blocks, constants_of(params))()
        return self.results(blocks, np.float32)


def _observed(
    kernel: Kernel,
    p: SnakeParams,
    rows: Sequence[Scalar],
    goal: Sequence[Scalar],
    before: Sequence[Scalar],
) -> list[Scalar]:
    """What EndsProgram gives; the phase is shifted where (18) holds."""
    lane = kernel.lane(rows)
    scp = [lane.phase == float(k) for k in range(1, len(goal) + 1)]
    feasible = lane.violation == RUNNING
    turns = [angle - begun for angle, begun in zip(lane.phi, before, strict=True)]
    scp_angle, next_angle, scp_turn = lane.phi[-1], lane.phi[-1], turns[-1]
    for k, is_scp in enumerate(scp[:-1]):
        scp_angle = select(is_scp, lane.phi[k], scp_angle)
        next_angle = select(is_scp, lane.phi[k + 1], next_angle)
        scp_turn = select(is_scp, turns[k], scp_turn)
    shift = both(feasible, absolute(scp_angle - lane.target) < p.epsilon_p)  # (18)
    duration = select(feasible, p.delta_t, lane.duration)
    lifted = [
        select(both(negate(is_scp), grounded == 0.0), 1.0, 0.0)
        for is_scp, grounded in zip(scp, lane.grounded, strict=True)
    ]
    phase = select(shift, lane.phase + 1.0, lane.phase)
    seen = features(
        p,
        lane.phi,
        goal,
        lane.w,
        phase,
        select(shift, 0.0, lane.phase_time + duration),
        select(shift, next_angle, lane.ref_start),
        scp_turn,
        lifted,
    )
    largest = functools.reduce(maximum, [absolute(turn) for turn in turns])
    return [phase, largest, *(value for values in seen.values() for value in values)]


@functools.cache
def get_ends_program(n_joints: int, head_contact: bool, lanes: int) -> EndsProgram:
    """The shared program for these sizes, compiled or loaded from the cache on first use."""
    return EndsProgram(n_joints, head_contact, lanes)
