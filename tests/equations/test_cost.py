"""The cost V of (19) and its gradient (14): closed forms, the oracle, descent, symmetries."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.modes import mode_table
from snake_env.sim.simulation import cost, joint_input
from snake_env.state import SnakeState
from tests.support import oracle
from tests.support.robots import (
    PAPER,
    all_lifted,
    oracle_constants,
    random_mode,
    random_state,
    seeds,
    shapes,
    straight_state,
)

C = oracle_constants(PAPER)
ONLY_LIMITS = PAPER.replace(a_l=1.0, a_c=0.0, a_s=0.0)
ONLY_DISTANCES = PAPER.replace(a_l=0.0, a_c=1.0, a_s=0.0)
ONLY_SINGULARITY = PAPER.replace(a_l=0.0, a_c=0.0, a_s=1.0)


def _state(phi: object, phase: int) -> SnakeState:
    angles = np.asarray(phi, dtype=float)
    return straight_state().replace(phi=angles, phase=phase)


def _close(gradient: NDArray[np.float64], expected: NDArray[np.float64]) -> bool:
    return bool(np.abs(gradient - expected).max() <= 1e-7 * max(1e-3, np.abs(expected).max()))


@given(seeds)
def test_cost__and_gradient_are_the_oracles(seed: int) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    v, gradient = cost(state, mode, PAPER)
    lifted = all_lifted(state, mode)
    assert v == pytest.approx(oracle.potential(state.phi, lifted, state.phase, C), rel=1e-9)
    assert _close(gradient, oracle.potential_gradient(state.phi, lifted, state.phase, C))


@pytest.mark.parametrize("params", [ONLY_LIMITS, ONLY_DISTANCES, ONLY_SINGULARITY])
def test_each_term__has_the_oracles_value_and_gradient(params) -> None:  # type: ignore[no-untyped-def]
    constants, touched = oracle_constants(params), 0
    for seed in range(60):
        state = random_state(seed, phase=1 + seed % 7)
        state = state.replace(phi=np.abs(state.phi))  # curled up
        mode = random_mode(seed, state)
        v, gradient = cost(state, mode, params)
        lifted = all_lifted(state, mode)
        expected = oracle.potential(state.phi, lifted, state.phase, constants)
        assert v == pytest.approx(expected, rel=1e-9, abs=1e-15)
        assert _close(
            gradient, oracle.potential_gradient(state.phi, lifted, state.phase, constants)
        )
        touched += expected > 0.0
    assert touched >= 10


@given(seeds, st.integers(0, 7))
def test_gradient__is_the_slope_of_the_cost_itself(seed: int, joint: int) -> None:
    params = ONLY_LIMITS.replace(a_c=3.0)
    state = random_state(seed)
    step = np.eye(8)[joint] * 1e-5
    ahead, _ = cost(state.replace(phi=state.phi + step), 0, params)
    behind, _ = cost(state.replace(phi=state.phi - step), 0, params)
    _, gradient = cost(state, 0, params)
    assert (ahead - behind) / 2e-5 == pytest.approx(gradient[joint], rel=1e-5, abs=1e-7)


def test_limit_term__is_the_cube_of_the_excess_behind_the_scp() -> None:
    phi = [1.5, -1.5, 1.0, 0.2, -1.2, 0.0, math.pi / 4, 0.9]
    v, gradient = cost(_state(phi, 2), 0, ONLY_LIMITS)
    excess = {2: 1.0 - math.pi / 4, 4: 1.2 - math.pi / 4, 7: 0.9 - math.pi / 4}
    assert v == pytest.approx(sum(x**3 for x in excess.values()), rel=1e-14)
    slopes = np.zeros(8)
    for k, x in excess.items():
        slopes[k] = 3 * x**2 * math.copysign(1, phi[k])
    assert gradient == pytest.approx(slopes, rel=1e-13, abs=0)


def test_collision_term__is_the_cube_of_the_nearness() -> None:
    phi = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2, math.pi / 2]
    body = 2 * PAPER.l * np.array([[-5.5, 0], [-6.5, 0], [-7, -0.5], [-6, -1]])  # W_5 W_6 W_7 tip
    v, _ = cost(_state(phi, 1), 0, ONLY_DISTANCES)
    near = [(body[3], body[0])]  # tail tip and W_5
    assert v == pytest.approx(
        sum(max(PAPER.d_0 - math.dist(a, b), 0) ** 3 for a, b in near), rel=1e-12
    )
    assert v > 0
    far, gradient = cost(_state(np.zeros(8), 1), 0, ONLY_DISTANCES)
    assert (far, gradient.any()) == (0.0, False)


def test_collision_term__counts_points_behind_the_scp_only() -> None:
    phi = [0.0, math.pi / 2, math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]
    values = [cost(_state(phi, phase), 0, ONLY_DISTANCES)[0] for phase in range(1, 9)]
    assert values[0] > 0
    assert all(a >= b for a, b in pairwise(values))
    assert values[7] == 0.0


def test_singularity_term__is_the_reciprocal_determinant() -> None:
    state = random_state(1, phase=1)
    for mode in (0, 20, 98):
        det = oracle.determinant(state.phi, all_lifted(state, mode), C)
        assert det > 10 * PAPER.det_floor
        assert cost(state, mode, ONLY_SINGULARITY)[0] == pytest.approx(1 / det, rel=1e-8)


@pytest.mark.parametrize("angle", [0.0, 0.05, -0.2, 0.4])
def test_singular_shapes__cost_the_floor_and_have_no_slope(angle: float) -> None:
    for mode in (0, 5, 98):
        v, gradient = cost(_state([angle] * 8, 1), mode, ONLY_SINGULARITY)
        assert v == 1 / PAPER.det_floor
        assert not gradient.any()


def test_front_joints__have_no_slope_from_the_joint_limits() -> None:
    _, gradient = cost(_state([1.5] * 4 + [0.0] * 4, 4), 0, ONLY_LIMITS)
    assert not gradient.any()


@given(seeds, st.floats(0.01, 2.99))
def test_redundant_input__never_climbs_the_cost(seed: int, t: float) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    params = PAPER.replace(u_limit=1e6)
    u_ker = joint_input(state, mode, t, params)
    u_ker = u_ker - joint_input(state, mode, t, params.replace(k_eta=0.0))
    _, gradient = cost(state, mode, PAPER)
    slope, scale = gradient @ u_ker, np.linalg.norm(gradient) * np.linalg.norm(u_ker)
    assert slope <= 1e-12 * scale
    k_eta = (1 - math.cos(2 * math.pi * t / 3)) * 2  # the projection is idempotent: (15)
    assert slope == pytest.approx(-(u_ker @ u_ker) / k_eta, rel=1e-6, abs=1e-9 * scale)


@given(shapes, seeds, st.integers(1, 8))
def test_mirrored_shape__has_the_same_cost_and_a_mirrored_slope(
    phi: NDArray[np.float64], seed: int, phase: int
) -> None:
    state = _state(phi, phase)
    mode = random_mode(seed, state)
    v, gradient = cost(state, mode, PAPER)
    mirrored, mirrored_gradient = cost(state.replace(phi=-phi), mode, PAPER)
    assert mirrored == v
    assert np.array_equal(mirrored_gradient, -gradient)


@given(seeds, st.floats(-5, 5), st.floats(-5, 5), st.floats(-7, 7))
def test_cost__does_not_depend_on_where_the_head_is(
    seed: int, x: float, y: float, heading: float
) -> None:
    state = random_state(seed)
    moved = state.replace(w=np.array([x, y, heading]))
    (v, gradient), (v_moved, gradient_moved) = (cost(s, 0, PAPER) for s in (state, moved))
    assert v == v_moved
    assert np.array_equal(gradient, gradient_moved)


@pytest.mark.parametrize("phase", range(1, 9))
def test_cost__is_finite_for_coinciding_links(phase: int) -> None:
    ring = _state([math.pi / 2] * 8, phase)  # every fourth link lies on the same place
    for mode in mode_table(8).valid(phase):
        v, gradient = cost(ring, int(mode), PAPER)
        assert math.isfinite(v)
        assert np.isfinite(gradient).all()


def test_cost__refuses_bad_modes_and_states() -> None:
    state = straight_state()
    with pytest.raises(InvalidModeError, match=r"^mode = 99"):
        cost(state, 99, PAPER)
    with pytest.raises(InvalidModeError, match="valid in phase 3"):
        cost(state.replace(phase=3), 1, PAPER)
    with pytest.raises(InvalidInputError, match=r"^state\.phi = .*nan.*finite"):
        cost(state.replace(phi=np.array([math.nan] * 8)), 0, PAPER)
