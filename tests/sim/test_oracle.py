"""The oracle itself against closed forms, and whole intervals of the package against the oracle."""

import math

import numpy as np
import pytest

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.simulation import advance, predict
from snake_env.state import SnakeState
from tests.support import oracle
from tests.support.robots import (
    KNIFE_EDGE,
    NARROW,
    PAPER,
    oracle_constants,
    oracle_interval,
    random_mode,
    random_state,
    sim_1_episode,
    stability_margin,
)

C = oracle.Constants()
COARSE = PAPER.replace(dt=0.1)  # five times fewer sub-steps, five times quicker
RNG = np.random.default_rng


def _velocity(k: int, direction: np.ndarray, w: np.ndarray, phi: np.ndarray) -> float:
    """How fast axle k moves sideways along a direction of (w, phi), by central differences."""
    step = 1e-6 * direction
    ahead = oracle.joints_and_centres(w + step[:3], phi + step[3:], C)[1][k]
    behind = oracle.joints_and_centres(w - step[:3], phi - step[3:], C)[1][k]
    heading = oracle.headings(w, phi)[k]
    return float((ahead - behind) @ [-math.sin(heading), math.cos(heading)] / 2e-6)


def test_constants__are_those_of_the_package() -> None:
    assert oracle_constants(PAPER) == oracle.Constants()


def test_places__of_a_straight_robot() -> None:
    joints, centres, tail = oracle.joints_and_centres(np.array([1.0, 2.0, math.pi]), np.zeros(8), C)
    assert np.allclose(centres, [[1.0 + C.l * (2 * k + 1), 2.0] for k in range(9)])
    assert np.allclose(joints, [[1.0 + C.l * 2 * k, 2.0] for k in range(1, 9)])
    assert np.allclose(tail, [1.0 + 18 * C.l, 2.0])


def test_matrices__are_the_sideways_velocities_of_the_axles() -> None:
    w, phi = np.array([0.3, -0.2, 0.7]), RNG(0).uniform(-1.5, 1.5, 8)
    a, b = oracle.matrices(w, phi, C)
    for k in range(1, 9):
        moved = [_velocity(k, direction, w, phi) for direction in np.eye(11)]
        assert a[k - 1] == pytest.approx(moved[:3], abs=1e-9)
        assert -b[k - 1] == pytest.approx(moved[3:], abs=1e-9)


def test_b__is_lower_triangular_with_l_on_the_diagonal() -> None:
    _, b = oracle.matrices(np.zeros(3), RNG(1).uniform(-1.5, 1.5, 8), C)
    assert not np.triu(b, 1).any()
    assert np.diag(b).tolist() == [C.l] * 8


def test_f__is_the_cube_below_the_threshold() -> None:
    assert (oracle.f(1.0, 3.0), oracle.f(3.0, 3.0), oracle.f(4.0, 3.0)) == (8.0, 0.0, 0.0)


def test_gradient__is_the_slope_of_the_potential() -> None:
    lifted = oracle.valid_modes(1, 8)[40]
    phi = RNG(2).uniform(-1.4, 1.4, 8)
    gradient = oracle.potential_gradient(phi, lifted, 1, C)
    step = 1e-5
    for k, direction in enumerate(np.eye(8) * step):
        ahead, behind = (oracle.potential(phi + d, lifted, 1, C) for d in (direction, -direction))
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient[k], rel=1e-4, abs=1e-5)


def test_gains__have_their_closed_forms() -> None:
    assert oracle.tracking_gain(np.zeros(8), 1, C) == 1.0
    assert oracle.tracking_gain(np.full(8, math.pi / 2), 8, C) == 1.0  # no rear joints
    assert oracle.tracking_gain(np.full(8, math.pi / 2), 1, C) == 0.0
    assert oracle.tracking_gain(np.full(8, 3 * math.pi / 8), 1, C) == pytest.approx(0.5)
    assert oracle.limiting_factor(np.array([0.1, -math.pi]), C) == 0.25
    assert oracle.limiting_factor(np.array([0.1, -0.7]), C) == 1.0
    assert [oracle.reference(2.0, 1.0, t, C) for t in (-1.0, 0.75, 9.0)] == pytest.approx(
        [1, 1.5, 2]
    )


def test_hull_and_margin__of_a_rectangle() -> None:
    corners = np.array([[0, 0], [2, 0], [2, 1], [0, 1], [1, 0.5], [1, 0]], dtype=float)
    hull = oracle.convex_hull(corners)
    assert sorted(map(tuple, hull)) == [(0, 0), (0, 1), (2, 0), (2, 1)]
    straight, none = np.zeros(8), np.zeros(8, dtype=bool)
    assert oracle.stability_margin(np.zeros(3), straight, none, C) == pytest.approx(C.track / 2)
    front = np.arange(8) >= 3  # wheels 1..3 stand, all before the centre of gravity
    assert oracle.stability_margin(np.zeros(3), straight, front, C) == pytest.approx(-2 * C.l)


def _compare(state: SnakeState, mode: int, params: SnakeParams) -> bool:
    """Compares one interval; returns whether it was feasible."""
    theirs, ours = oracle_interval(state, mode, params), predict(state, [mode], params)
    if theirs.violation != ours.violation[0]:
        ends = (theirs.phi, ours.phi[0])
        margins = [abs(stability_margin(phi, state, mode, params)) for phi in ends]
        if min(margins) < KNIFE_EDGE:
            pytest.skip("on the edge of stability")
    assert ours.violation[0] == theirs.violation
    assert ours.feasible[0] == theirs.feasible
    assert np.abs(ours.phi[0] - theirs.phi).max() <= 1e-8
    assert np.abs(ours.w[0] - theirs.w).max() <= 1e-8
    assert ours.d_min[0] == pytest.approx(theirs.d_min, rel=0, abs=1e-8)
    assert ours.max_abs_phi[0] == pytest.approx(theirs.max_abs_phi, rel=0, abs=1e-8)
    if theirs.feasible:
        assert ours.j[0] == pytest.approx(theirs.j, rel=1e-7)
        assert ours.cost[0] == pytest.approx(theirs.cost, rel=1e-7)
    else:
        assert ours.j[0] == theirs.j == math.inf
    return theirs.feasible


def _random_case(
    seed: int, params: SnakeParams, phase: int | None = None
) -> tuple[SnakeState, int]:
    state = random_state(seed, params, phase)
    return state, random_mode(seed, state)


@pytest.mark.parametrize("phase", range(1, 9))
def test_interval__is_the_oracles_in_coarse_steps(phase: int) -> None:
    assert any(_compare(*_random_case(100 * phase + k, COARSE, phase), COARSE) for k in range(2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_interval__is_the_oracles(seed: int) -> None:
    _compare(*_random_case(seed, PAPER), PAPER)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stability", "joint_limit"])
def test_violations__are_the_oracles(name: str) -> None:
    compared = 0
    for seed in range(300):
        case = _random_case(1000 + seed, NARROW)
        if predict(case[0], [case[1]], NARROW).violation[0] == name and compared < 6:
            assert not _compare(*case, NARROW)
            compared += 1
    assert compared == 6


VARIANTS = {
    "hardware": SnakeParams.preset("hardware"),
    "narrow": SnakeParams.preset("narrow", dt=0.1),
    "5 joints": COARSE.replace(n_joints=5),
    "6 joints": COARSE.replace(n_joints=6),
    "12 joints": COARSE.replace(n_joints=12),
    "other constants": SnakeParams(
        l=0.12, track=0.2, delta_t=2.0, dt=0.1, cam_time=1.1, c_phi=0.5, d_0=0.5, a_l=1.5,
        a_c=300.0, a_s=1e-3, a_scp=1e-2, gains=(0.8, 1.1, 0.6, 1.5), k_0=0.6, k_eta=1.3,
        w_d=(0.1, -0.2, 1.0), phi_limit=1.4, u_limit=0.6, det_floor=1e-5,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_interval__is_the_oracles_for_other_constants(name: str) -> None:
    params = VARIANTS[name]
    assert sum(_compare(*_random_case(seed, params), params) for seed in range(6)) >= 2


@pytest.mark.slow
def test_sim_1__replayed_by_the_oracle_ends_in_the_same_shape_and_time() -> None:
    states, modes, _ = sim_1_episode()
    state = states[0]
    for mode in modes:
        outcome = oracle_interval(state, mode, PAPER)
        assert outcome.feasible
        error = abs(outcome.phi[state.phase - 1] - state.target[state.phase - 1])
        shifts = error < 0.05  # (18)
        state = state.replace(
            phi=outcome.phi,
            w=outcome.w,
            phase=state.phase + shifts,
            phase_time=0.0 if shifts else state.phase_time + 3.0,
            ref_start=float(outcome.phi[min(state.phase, 7)]) if shifts else state.ref_start,
            elapsed=state.elapsed + 3.0,
        )
    assert (state.phase, state.elapsed) == (9, 36.0)
    assert np.abs(state.phi - states[-1].phi).max() <= 1e-6


@pytest.mark.slow
def test_sim_1__mode_of_phase_5_is_the_oracles_cheapest_too() -> None:
    states, modes, _ = sim_1_episode()
    valid = mode_table(8).valid(5)
    assert states[5].phase == 5
    j = [oracle_interval(states[5], int(mode), PAPER).j for mode in valid]
    assert valid[int(np.argmin(j))] == modes[5]
    assert predict(states[5], valid, PAPER).j == pytest.approx(j, rel=1e-7)


def test_singular_start__is_the_oracles() -> None:
    for angle, target in ((0.0, 0.05), (0.05, 0.0), (0.3, 0.5)):
        state = SnakeState.initial([angle] * 8, [target] * 8, COARSE)
        _compare(state, 0, COARSE)
        _compare(advance(state, 0, COARSE)[0], 0, COARSE)
