"""What is drawn: the places of the parts against the oracle, and the artists on the axes."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from snake_env.errors import MissingDependencyError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.rendering.drawing import (
    BODY,
    GRAVITY,
    GROUNDED,
    LIFTED,
    TARGET,
    convex_hull,
    draw_robot,
    geometry,
    lifted_wheels,
)
from snake_env.state import SnakeState
from tests.support import oracle
from tests.support.robots import (
    NARROW,
    PAPER,
    all_lifted,
    oracle_constants,
    random_mode,
    random_state,
    seeds,
)

C = oracle_constants(PAPER)
cells = st.tuples(st.integers(-3, 3), st.integers(-3, 3))


def _axles(state: SnakeState) -> np.ndarray:
    """Left and right wheel of axles 1..n, (n, 2, 2)."""
    theta = oracle.headings(state.w, state.phi)[1:]
    _, centres, _ = oracle.joints_and_centres(state.w, state.phi, C)
    side = PAPER.track / 2 * np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    return np.stack([centres[1:] + side, centres[1:] - side], axis=1)


def _coloured(lines: list[Line2D], colour: str) -> list[Line2D]:
    return [line for line in lines if same_color(line.get_color(), colour)]


def _corners(points: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(np.round(point, 9) + 0.0) for point in points}


@given(seeds)
def test_geometry__is_the_oracles(seed: int) -> None:
    state = random_state(seed, head_error=1.0)
    place = geometry(state.phi, state.w, PAPER)
    joints, centres, tail = oracle.joints_and_centres(state.w, state.phi, C)
    expected = np.vstack([state.w[:2], joints, tail])
    np.testing.assert_allclose(place.outline, expected, atol=1e-12)
    np.testing.assert_allclose(place.centres, centres, atol=1e-12)
    np.testing.assert_allclose(place.gravity, centres.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(place.head_contact, centres[:1], atol=1e-12)
    np.testing.assert_allclose(place.axles, _axles(state), atol=1e-12)


def test_geometry__of_a_narrow_robot_has_no_head_contact() -> None:
    place = geometry(np.zeros(8), np.zeros(3), NARROW)
    assert place.head_contact.shape == (0, 2)
    assert place.axles.shape == (8, 2, 2)


@given(st.lists(cells, min_size=3, max_size=12))
def test_convex_hull__is_the_oracles(points: list[tuple[int, int]]) -> None:
    array = np.array(points, dtype=np.float64)
    expected = oracle.convex_hull(array)
    hull = convex_hull(array)
    if len(expected) >= 3:
        assert _corners(hull) == _corners(np.array(expected))
        assert len(hull) == len(expected)
        area = 0.5 * sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(hull, np.roll(hull, -1, 0)))  # noqa: B905
        assert area > 0  # anticlockwise


@given(seeds)
def test_lifted_wheels__are_the_modes_and_the_scps(seed: int) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    assert lifted_wheels(mode, state.phase, PAPER).tolist() == all_lifted(state, mode).tolist()


def test_lifted_wheels__has_no_scp_at_the_end_and_leaves_the_table_alone() -> None:
    mode = mode_table(8).index([7, 8])
    before = mode_table(8).lifted.copy()
    assert np.flatnonzero(lifted_wheels(mode, 9, PAPER)).tolist() == [6, 7]
    assert np.flatnonzero(lifted_wheels(mode, 5, PAPER)).tolist() == [4, 6, 7]
    assert (mode_table(8).lifted == before).all()


@pytest.mark.parametrize("params", [PAPER, NARROW], ids=["paper", "narrow"])
@pytest.mark.parametrize("seed", range(3))
def test_draw_robot__shows_wheels_support_gravity_and_target(
    seed: int, params: SnakeParams
) -> None:
    state = random_state(seed, params, 3, head_error=0.3)
    lifted = all_lifted(state, random_mode(seed, state))
    ax = Figure().subplots()
    draw_robot(ax, state.phi, state.w, lifted, params, state.target)
    axles = _axles(state)
    lines = list(ax.lines)
    for colour, up in ((GROUNDED, False), (LIFTED, True)):
        drawn = [line.get_xydata() for line in _coloured(lines, colour)]
        np.testing.assert_allclose(drawn, axles[lifted == up], atol=1e-12)
    joints, centres, tail = oracle.joints_and_centres(state.w, state.phi, C)
    (body,) = _coloured(lines, BODY)
    np.testing.assert_allclose(body.get_xydata(), np.vstack([state.w[:2], joints, tail]), atol=1e-9)
    (gravity,) = _coloured(lines, GRAVITY)
    np.testing.assert_allclose(gravity.get_xydata()[0], centres.mean(axis=0), atol=1e-12)
    head = [centres[0]] if params.head_contact else []
    hull = oracle.convex_hull(np.array([*head, *axles[~lifted].reshape(-1, 2)]))
    (support,) = [patch for patch in ax.patches if isinstance(patch, Polygon)]
    assert _corners(support.get_xy()) == _corners(np.array(hull))
    joints, _, tail = oracle.joints_and_centres(np.array(params.w_d), state.target, C)
    for ghost in _coloured(lines, TARGET):
        np.testing.assert_allclose(ghost.get_xydata()[1:], np.vstack([joints, tail]), atol=1e-9)
    assert len(_coloured(lines, TARGET)) == 2
    assert ax.get_aspect() == 1.0


def test_draw_robot__without_target_has_no_ghost() -> None:
    ax = Figure().subplots()
    draw_robot(ax, np.zeros(8), np.array([0.0, 0.0, math.pi]), np.zeros(8, dtype=np.bool_), PAPER)
    assert not _coloured(list(ax.lines), TARGET)
    assert len(_coloured(list(ax.lines), GROUNDED)) == 8


def test_draw_robot__without_matplotlib_names_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    ax = Figure().subplots()
    monkeypatch.setitem(sys.modules, "matplotlib.patches", None)
    with pytest.raises(MissingDependencyError, match=r"pip install snake-mode-env\[render\]"):
        draw_robot(ax, np.zeros(8), np.zeros(3), np.zeros(8, dtype=np.bool_), PAPER)
