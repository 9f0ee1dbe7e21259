"""Skidding: least squares of the wheels' slip against the oracle's matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from snake_env.params import SnakeParams
from snake_env.policies.skid import constraint_matrices, skid
from snake_env.sim.tasks import load_tasks, random_suite
from snake_env.state import SnakeState
from tests.support import oracle
from tests.support.robots import PAPER, oracle_constants, shapes, straight_state

C = oracle_constants(PAPER)
SUITE = random_suite(12, 5, PAPER)


def _joint_path(state: SnakeState, params: SnakeParams) -> np.ndarray:
    """Each joint straight to its target, at u_limit until the last step, (K + 1, n) [rad]."""
    step = params.u_limit * params.dt
    sides = np.sign(state.target - state.phi)
    distance = abs(state.target - state.phi)
    count = max(math.ceil(d / step - 1e-9) for d in distance)
    return np.array([state.phi + sides * np.minimum(k * step, distance) for k in range(count + 1)])


@given(shapes, st.floats(-math.pi, math.pi))
def test_constraint_matrices__are_the_oracles(phi: np.ndarray, heading: float) -> None:
    a, b = constraint_matrices(phi, PAPER)
    w = np.array([0.3, -0.2, heading])
    expected_a, expected_b = oracle.matrices(w, phi, C)
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]]
    np.testing.assert_allclose(a @ turn, expected_a, atol=1e-12)
    np.testing.assert_allclose(b, expected_b, atol=1e-12)


def test_constraint_matrices__of_a_straight_robot() -> None:
    a, b = constraint_matrices(np.zeros(8), PAPER)
    link = 2 * PAPER.l
    np.testing.assert_allclose(a[:, 0], 0.0, atol=1e-15)
    np.testing.assert_allclose(a[:, 1], 1.0)
    np.testing.assert_allclose(a[:, 2], [-(k + 0.5) * link for k in range(1, 9)], rtol=1e-14)
    expected = [[max(k - i + 0.5, 0.0) * link for i in range(1, 9)] for k in range(1, 9)]
    np.testing.assert_allclose(b, expected, atol=1e-14)


@pytest.mark.parametrize("task", range(4))
def test_head__moves_with_the_least_slip(task: int) -> None:
    state = SUITE.initial(task, PAPER)
    state = state.replace(w=np.array([0.5, -1.0, 2.0]))
    _, path = skid(state, PAPER)
    phi = _joint_path(state, PAPER)
    assert len(path) == len(phi)
    rng = np.random.default_rng(task)
    for k in range(0, len(phi) - 1, 7):
        a, b = oracle.matrices(path[k], phi[k], C)
        u = (phi[k + 1] - phi[k]) / PAPER.dt
        velocity = (path[k + 1] - path[k]) / PAPER.dt
        slip = np.linalg.norm(a @ velocity - b @ u)
        np.testing.assert_allclose(a.T @ (a @ velocity - b @ u), 0.0, atol=1e-9)
        for direction in rng.normal(size=(6, 3)):
            for size in (1e-3, -1e-3, 0.5):
                assert np.linalg.norm(a @ (velocity + size * direction) - b @ u) > slip


@pytest.mark.parametrize("task", range(12))
def test_joints__reach_the_target_at_the_speed_limit(task: int) -> None:
    state = SUITE.initial(task, PAPER)
    summary, path = skid(state, PAPER)
    longest = abs(state.target - state.phi).max()
    steps = math.ceil(longest / (PAPER.u_limit * PAPER.dt) - 1e-9)
    assert len(path) == steps + 1
    assert summary.time_s == pytest.approx(steps * PAPER.dt)
    assert summary.time_s >= longest / PAPER.u_limit - 1e-9
    assert summary.intervals == math.ceil(summary.time_s / 3.0)
    ends = abs(np.array([state.phi, state.target])).max()
    assert summary.max_abs_phi == pytest.approx(ends, abs=1e-9)
    assert (summary.outcome, summary.phase) == ("success", 9)
    closest = min(oracle.minimum_distance(np.zeros(3), x, C) for x in _joint_path(state, PAPER))
    assert summary.d_min == pytest.approx(closest, abs=1e-9)
    assert math.isnan(summary.cost_integral)


def test_head__ends_off_in_sim_1() -> None:
    """Fig. 7(a): the real robot's head ended 0.07 m, 0.38 m and 1.1 rad off."""
    summary, path = skid(load_tasks("sim-1", PAPER).initial(0, PAPER), PAPER)
    error = abs(path - np.array(PAPER.w_d))
    assert np.hypot(*error[-1, :2]) > 0.1
    assert error[-1, 2] > 0.3
    assert summary.head_error_m == pytest.approx(np.hypot(error[:, 0], error[:, 1]).max())
    assert summary.head_error_rad == error[:, 2].max()


def test_still_robot__goes_nowhere() -> None:
    summary, path = skid(straight_state(), PAPER)
    assert path.tolist() == [list(PAPER.w_d)]
    assert (summary.time_s, summary.intervals, summary.head_error_m) == (0.0, 0, 0.0)


def test_path__moves_rigidly_with_the_head() -> None:
    state = SUITE.initial(0, PAPER)
    _, path = skid(state.replace(w=np.zeros(3)), PAPER)
    _, moved = skid(state.replace(w=np.array([1.0, 2.0, 0.7])), PAPER)
    turn = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    np.testing.assert_allclose(moved[:, :2], path[:, :2] @ turn + [1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(moved[:, 2], path[:, 2] + 0.7, atol=1e-12)


@settings(max_examples=10)
@given(st.integers(0, 11))
def test_mirrored_task__gives_the_mirrored_path(task: int) -> None:
    state = SUITE.initial(task, PAPER).replace(w=np.zeros(3))
    _, path = skid(state, PAPER)
    _, mirrored = skid(state.replace(phi=-state.phi, target=-state.target), PAPER)
    np.testing.assert_allclose(mirrored * [1, -1, -1], path, atol=1e-12)


def test_collision__is_reported() -> None:
    state = SUITE.initial(3, PAPER)
    closest = skid(state, PAPER)[0].d_min
    for margin, outcome in ((1e-6, "collision"), (-1e-6, "success")):
        summary, _ = skid(state, PAPER.replace(track=closest + margin))
        phase = 9 if outcome == "success" else state.phase
        assert (summary.outcome, summary.phase) == (outcome, phase)
