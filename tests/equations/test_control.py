"""The joint input: rolling wheels, the null space, gains, and the oracle's input."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from snake_env.equations import control
from snake_env.equations.kinematics import locate
from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.modes import mode_table
from snake_env.sim.motion import trajectory
from snake_env.sim.simulation import joint_input
from tests.support import oracle
from tests.support.robots import (
    PAPER,
    all_lifted,
    feasible_case,
    oracle_arguments,
    oracle_constants,
    random_mode,
    random_state,
    seeds,
    straight_state,
)

C = oracle_constants(PAPER)
UNLIMITED = PAPER.replace(u_limit=1e6)
times = st.floats(0.0, 3.0)


def _b_tilde(state, mode) -> NDArray[np.float64]:  # type: ignore[no-untyped-def]
    """B-tilde of (6): the grounded wheels' rows of B, and the SCP's."""
    _, b = oracle.matrices(state.w, state.phi, C)
    return np.vstack([b[~all_lifted(state, mode)], np.eye(8)[state.phase - 1]])


@given(seeds, times)
def test_grounded_wheels__do_not_slide(seed: int, t: float) -> None:
    state = random_state(seed, head_error=0.3)
    mode = random_mode(seed, state)
    unlimited, w_rate = oracle.unlimited_input(**oracle_arguments(state, mode), t=t, c=C)
    w_rate = oracle.limiting_factor(unlimited, C) * w_rate
    a, b = oracle.matrices(state.w, state.phi, C)
    residual = (a @ w_rate - b @ joint_input(state, mode, t, PAPER))[~all_lifted(state, mode)]
    assert np.abs(residual).max() <= 1e-10


@given(seeds, st.integers(0, 149))
def test_grounded_wheels__do_not_slide_in_the_kernel(seed: int, step: int) -> None:
    state, mode = feasible_case(seed)
    motion = trajectory(state, mode, PAPER)
    a, b = oracle.matrices(motion.w[step], motion.phi[step], C)
    w_rate = (motion.w[step + 1] - motion.w[step]) / PAPER.dt
    residual = (a @ w_rate - b @ motion.u[step])[~all_lifted(state, mode)]
    assert np.abs(residual).max() <= 1e-10


@given(seeds, times)
def test_input__is_the_oracles(seed: int, t: float) -> None:
    state = random_state(seed, head_error=0.1)
    mode = random_mode(seed, state)
    expected = oracle.joint_input(**oracle_arguments(state, mode), t=t, c=C)
    assert joint_input(state, mode, t, PAPER) == pytest.approx(expected, rel=0, abs=1e-8)


@given(seeds, times)
def test_null_space_input__moves_neither_head_nor_scp(seed: int, t: float) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    redundant = joint_input(state, mode, t, UNLIMITED)
    redundant -= joint_input(state, mode, t, UNLIMITED.replace(k_eta=0.0))
    assert np.abs(_b_tilde(state, mode) @ redundant).max() <= 1e-12 * max(1, *np.abs(redundant))
    assert np.all(redundant[: state.phase] == 0.0)
    b_tilde = _b_tilde(state, mode)
    null = np.eye(8) - np.linalg.pinv(b_tilde) @ b_tilde
    gradient = oracle.potential_gradient(state.phi, all_lifted(state, mode), state.phase, C)
    expected = -control.redundancy_gain(t, PAPER) * null @ gradient
    assert np.allclose(redundant, expected, rtol=1e-8, atol=1e-10)


def test_null_space_input__leaves_the_way_of_head_and_scp_unchanged() -> None:
    params = UNLIMITED.replace(k_0=1e-9)  # so that k_u = k_t = 1, whatever the rear joints do
    state = random_state(6, phase=2)
    mode = mode_table(8).index([5, 7])
    still = trajectory(state, mode, params.replace(k_eta=0.0))
    moving = trajectory(state, mode, params)
    assert len(moving.u) == len(still.u) == 150
    assert np.abs(moving.phi - still.phi).max() > 0.01
    assert np.array_equal(moving.w, still.w)
    assert np.array_equal(moving.phi[:, :2], still.phi[:, :2])


@given(seeds, times)
def test_front_joints__are_frozen_while_the_head_is_in_place(seed: int, t: float) -> None:
    state = random_state(seed, head_error=0.0)
    u = joint_input(state, random_mode(seed, state), t, PAPER)
    assert np.all(u[: state.phase - 1] == 0.0)


def test_front_joints__move_when_the_head_is_off() -> None:
    state = random_state(3, phase=5, head_error=0.1)
    assert np.all(joint_input(state, 0, 0.0, PAPER)[:4] != 0.0)


@given(seeds, st.sampled_from([0.0, 3.0]))
def test_input__is_the_same_for_all_modes_at_the_ends_of_an_interval(seed: int, t: float) -> None:
    state = random_state(seed, head_error=0.1)
    valid = mode_table(8).valid(state.phase)
    first = joint_input(state, int(valid[0]), t, PAPER)
    assert all(np.array_equal(joint_input(state, int(m), t, PAPER), first) for m in valid[1:])


def test_input__differs_between_modes_inside_an_interval() -> None:
    state = random_state(0, phase=1)
    inputs = {joint_input(state, mode, 1.0, PAPER).tobytes() for mode in range(99)}
    assert len(inputs) > 50


@given(seeds, times)
def test_input__keeps_the_speed_limit_and_its_direction(seed: int, t: float) -> None:
    state = random_state(seed, head_error=0.5)
    mode = random_mode(seed, state)
    u, free = joint_input(state, mode, t, PAPER), joint_input(state, mode, t, UNLIMITED)
    fastest = np.abs(free).max()
    assert np.abs(u).max() == pytest.approx(min(fastest, PAPER.u_limit), rel=1e-14)
    assert u == pytest.approx(free * min(1.0, PAPER.u_limit / fastest), rel=1e-13)


@given(seeds)
def test_scp__goes_to_its_reference(seed: int) -> None:
    state = random_state(seed, head_error=0.0)
    u = joint_input(state, 0, 1.0, UNLIMITED.replace(k_eta=0.0))
    scp = state.phase - 1
    wanted = oracle.reference(state.target[scp], state.ref_start, state.phase_time + 1.0, C)
    gain = oracle.tracking_gain(state.phi, state.phase, C) * 2.0
    assert u[scp] == pytest.approx(-gain * (state.phi[scp] - wanted), rel=1e-12, abs=1e-15)


def test_last_two_joints__turn_in_the_ratio_that_wheel_8_dictates() -> None:
    state = random_state(4, phase=7, head_error=0.0)
    u = joint_input(state, 0, 1.0, PAPER)
    assert u[6] != 0.0
    assert u[7] == pytest.approx(-(1 + 2 * math.cos(state.phi[7])) * u[6], rel=1e-12)


def test_rolling_rates__of_a_straight_robot_in_a_turn_alternate() -> None:
    still = (0.0, 0.0, 0.0)
    rates = control.rolling_rates(
        locate([0.0] * 4, 1.0), 1.0, still, lambda k, rolling: 1.0 if k == 1 else rolling
    )
    assert rates == [1.0, -3.0, 4.0, -4.0]


def test_redundancy_gain__vanishes_at_both_ends_of_an_interval() -> None:
    gain = control.redundancy_gain
    assert gain(0.0, PAPER) == gain(PAPER.delta_t, PAPER) == 0.0
    assert gain(1.5, PAPER) == pytest.approx(4.0, rel=1e-15)
    assert gain(0.75, PAPER) == pytest.approx(2.0, rel=1e-15)


def test_cam__runs_smoothly_from_start_to_target() -> None:
    cam = [control.reference(-0.4, 1.2, t, PAPER) for t in np.linspace(0.0, 1.5, 101).tolist()]
    assert (cam[0], cam[50], cam[100]) == pytest.approx((-0.4, 0.4, 1.2), abs=1e-15)
    assert all(a < b for a, b in pairwise(cam))
    assert max(cam[1] - cam[0], cam[100] - cam[99]) < 1e-4  # it starts and ends at rest
    assert control.reference(-0.4, 1.2, 1.5001, PAPER) == control.reference(-0.4, 1.2, 99.0, PAPER)
    assert cam[25] == pytest.approx(-0.4 + 1.6 * (0.25 - 1 / (2 * math.pi)), rel=1e-14)


@pytest.mark.parametrize(
    ("margin", "gain"),
    [(math.inf, 1.0), (2.0, 1.0), (math.pi / 4, 1.0), (math.pi / 8, 0.5),
     (math.pi / 16, 0.5 - 0.5**1.5), (0.0, 0.0), (-0.1, 0.0)],
)  # fmt: skip
def test_tracking_gain__fades_out_towards_the_limit(margin: float, gain: float) -> None:
    assert control.tracking_gain(margin, PAPER) == pytest.approx(gain, rel=1e-15, abs=1e-16)


def test_limit_margin__looks_at_rear_joints_only() -> None:
    phi, rear = [1.5, -1.2, 0.3, -1.4], [False, False, True, True]
    assert control.limit_margin(phi, rear, PAPER) == PAPER.phi_limit - 1.4
    assert control.limit_margin(phi, [False] * 4, PAPER) == math.inf


@pytest.mark.parametrize("t", [-0.01, 3.01, math.nan, math.inf])
def test_joint_input__refuses_times_outside_the_interval(t: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^t = .*from 0 to delta_t = 3\.0") as caught:
        joint_input(straight_state(), 0, t, PAPER)  # type: ignore[arg-type]
    assert caught.value.field == "t"


@pytest.mark.parametrize("mode", [-1, 99, 1.0, None, True])
def test_joint_input__refuses_what_is_no_mode(mode: object) -> None:
    with pytest.raises(InvalidModeError, match=r"^mode = .*from 0 to 98"):
        joint_input(straight_state(), mode, 0.0, PAPER)  # type: ignore[arg-type]
