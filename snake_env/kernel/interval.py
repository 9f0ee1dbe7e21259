"""The one kernel: blocks of lanes advanced through an interval, sub-step by sub-step.

A lane is one state with one mode. :func:`sub_step` says what happens to it, on generic scalars; here
it is traced, compiled and run over blocks. Predictions, the optimiser, the masks, the env and the
vector env all run it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass

from snake_env.equations.control import limited_input, reference
from snake_env.equations.cost import cost_and_gradient
from snake_env.equations.kinematics import Body, least_squared_distance, locate
from snake_env.equations.scalars import (
    Bool,
    Scalar,
    absolute,
    both,
    maximum,
    minimum,
    negate,
    select,
)
from snake_env.equations.stability import statically_stable
from snake_env.equations.tracing import Trace
from snake_env.kernel.blocks import BlockProgram, traced_params
from snake_env.kernel.lane_function import LaneFunction
from snake_env.modes import MIN_GROUNDED
from snake_env.params import SnakeParams

RUNNING, UNSTABLE, BEYOND_LIMIT, PADDING = 0.0, 1.0, 2.0, 3.0  # values of a lane's `violation`


@dataclass
class Lane:
    """One state with one mode, as generic scalars.

    Attributes:
        phi: Joint angles, n values [rad].
        w: Head pose, 3 values [m, m, rad].
        u: The last sub-step's joint input, n values [rad/s].
        integral: Integral of V so far [s].
        duration: Time executed so far [s].
        violation: ``RUNNING``, or what stopped the lane.
        d2_min: Square of the least d_min so far [m^2].
        max_abs_phi: Largest joint angle so far, in size [rad].
        phase: The SCP's number.
        target: The SCP's target [rad].
        ref_start: The SCP's angle when the phase began [rad].
        phase_time: Time since then, at the interval's start [s].
        grounded: 1 for each grounded wheel, else 0: n values.
        wheels: Numbers of the lifted rear wheels in rising order, then zeros: n - 4 values.
    """

    phi: list[Scalar]
    w: list[Scalar]
    u: list[Scalar]
    integral: Scalar
    duration: Scalar
    violation: Scalar
    d2_min: Scalar
    max_abs_phi: Scalar
    phase: Scalar
    target: Scalar
    ref_start: Scalar
    phase_time: Scalar
    grounded: list[Scalar]
    wheels: list[Scalar]

    def grounded_marks(self) -> list[Bool]:
        """Whether each wheel is grounded."""
        return [mark == 1.0 for mark in self.grounded]


@functools.cache
def layout(n_joints: int) -> dict[str, slice]:
    """Rows of the lane buffer that hold each field of :class:`Lane`."""
    most = n_joints - 1 - MIN_GROUNDED
    lengths = {"phi": n_joints, "w": 3, "u": n_joints, "grounded": n_joints, "wheels": most}
    rows: dict[str, slice] = {}
    row = 0
    for field in dataclasses.fields(Lane):
        length = lengths.get(field.name, 1)
        rows[field.name] = slice(row, row + length)
        row += length
    return rows


def visit(lane: Lane, p: SnakeParams) -> Body:
    """What happens wherever a running lane arrives: d_min is noted and (22) is tested."""
    body = locate(lane.phi, p.l)
    running = lane.violation == RUNNING
    least = minimum(least_squared_distance(body), lane.d2_min)
    lane.d2_min = select(running, least, lane.d2_min)
    unstable = negate(statically_stable(body, lane.grounded_marks(), p))
    lane.violation = select(both(running, unstable), UNSTABLE, lane.violation)
    return body


def cost_and_input(
    lane: Lane, body: Body, t: Scalar, k_eta: Scalar, p: SnakeParams
) -> tuple[Scalar, list[Scalar], list[Scalar]]:
    """V (19), the joint input (29) and the head's velocity at time ``t``."""
    joints = range(1, len(lane.phi) + 1)
    scp = [lane.phase == float(k) for k in joints]
    rear = _rear(lane.phase, len(lane.phi))
    columns = [[wheel == float(k) for k in joints] for wheel in lane.wheels]
    v, gradient = cost_and_gradient(body, lane.phi, rear, lane.grounded_marks(), p)
    scp_reference = reference(lane.ref_start, lane.target, lane.phase_time + t, p)
    u, w_rate = limited_input(
        body, lane.phi, lane.w, scp_reference, scp, rear, columns, gradient, k_eta, p
    )
    return v, u, w_rate


def _rear(phase: Scalar, n_joints: int) -> list[Bool]:
    """Whether each joint is behind the SCP."""
    return [phase < float(k) for k in range(1, n_joints + 1)]


def sub_step(lane: Lane, t: Scalar, k_eta: Scalar, p: SnakeParams) -> None:
    """One sub-step of a lane: a running lane moves on, or stops at its first violation."""
    body = visit(lane, p)
    running = lane.violation == RUNNING
    v, lane.u, w_rate = cost_and_input(lane, body, t, k_eta, p)

    def moved(value: Scalar, rate: Scalar) -> Scalar:  # gates the rate, as select with 0 is cheap
        return value + p.dt * select(running, rate, 0.0)

    lane.integral = moved(lane.integral, v)
    lane.duration = moved(lane.duration, 1.0)
    lane.phi = [moved(x, rate) for x, rate in zip(lane.phi, lane.u, strict=True)]
    lane.w = [moved(x, rate) for x, rate in zip(lane.w, w_rate, strict=True)]
    largest = functools.reduce(maximum, [absolute(x) for x in lane.phi])
    lane.max_abs_phi = maximum(largest, lane.max_abs_phi)
    within = largest <= p.phi_limit + p.limit_tolerance  # (23)
    lane.violation = select(both(running, negate(within)), BEYOND_LIMIT, lane.violation)


class Kernel(BlockProgram):
    """The compiled kernel for a number of joints.

    Attributes:
        rows: Rows of a block that hold each field of :class:`Lane`.
        n_rows: Rows of a block.
        lanes: Lanes of a block.
    """

    def __init__(self, n_joints: int, head_contact: bool, lanes: int) -> None:
        self.rows = layout(n_joints)
        loop, last = Trace(), Trace()
        n_rows = max(rows.stop for rows in self.rows.values())
        lane = self.lane([loop.lane(row) for row in range(n_rows)])
        sub_step(lane, loop.clock(0), loop.clock(1), traced_params(loop, head_contact))
        self._store(loop, lane)
        lane = self.lane([last.lane(row) for row in range(n_rows)])
        visit(lane, traced_params(last, head_contact))
        self._store(last, lane)
        running = self.rows["violation"].start
        super().__init__(loop, last, n_rows, running, f"{n_joints} joints", lanes)

    def lane(self, values_by_row: Sequence[Scalar]) -> Lane:
        """A lane of the values in the rows of a block."""
        values = {name: list(values_by_row[rows]) for name, rows in self.rows.items()}
        lists = ("phi", "w", "u", "grounded", "wheels")
        fields = {name: v if name in lists else v[0] for name, v in values.items()}
        return Lane(**fields)  # type: ignore[arg-type]

    def _store(self, trace: Trace, lane: Lane) -> None:
        for name, rows in self.rows.items():
            value = getattr(lane, name)
            values: Sequence[Scalar] = value if isinstance(value, list) else [value]
            for row, scalar in zip(range(rows.start, rows.stop), values, strict=True):
                if trace.operations[trace.position(scalar)] != ("lane", (row,)):  # it was changed
                    trace.store(row, scalar)


@functools.cache
def get_kernel(n_joints: int, head_contact: bool, lanes: int) -> Kernel:
    """The shared kernel for these sizes, compiled or loaded from the cache on first use.

    Args:
        n_joints: Joints of the robots.
        head_contact: That of the constants.
        lanes: Lanes of a block, see :func:`snake_env.kernel.blocks.block_width`.
    """
    return Kernel(n_joints, head_contact, lanes)


@functools.cache
def get_cost_program(n_joints: int) -> LaneFunction:
    """V (19) and its gradient (14), from joint angles, phase and marks of the grounded wheels."""

    def program(
        p: SnakeParams, phi: list[Scalar], phase: Scalar, grounded: list[Scalar]
    ) -> list[Scalar]:
        marks = [mark == 1.0 for mark in grounded]
        body, rear = locate(phi, p.l), _rear(phase, n_joints)
        v, gradient = cost_and_gradient(body, phi, rear, marks, p)
        return [v, *gradient]

    lengths = (n_joints, 1, n_joints)
    return LaneFunction(program, lengths, True, f"the cost of {n_joints} joints")
