"""Where the links are: closed forms, the oracle's places, rigid motions and mirror images."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from snake_env.equations.kinematics import (
    Body,
    centre_of_gravity,
    guarded_pairs,
    locate,
    squared_distance,
    to_world,
)
from snake_env.kernel.distance import d_min
from tests.support import oracle
from tests.support.robots import shapes

L = 0.091
C = oracle.Constants()
poses = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-10, 10)).map(np.array)
FOLDED = np.array([0.0, 0.0, 0.0, math.pi / 2, math.pi / 2, 0.0, 0.0, 0.0])


def _body(phi: object, l: float = L) -> Body:  # noqa: E741
    return locate([float(angle) for angle in np.asarray(phi)], l)


def test_locate__of_a_straight_robot_is_a_line_behind_the_head() -> None:
    body = _body(np.zeros(8), l=1.0)
    assert body.centres == [(-1.0 - 2.0 * k, 0.0) for k in range(9)]
    assert body.joints == [(-2.0 * k, 0.0) for k in range(9)]
    assert body.tail == (-18.0, 0.0)
    assert body.directions == [(1.0, 0.0)] * 9


def test_locate__of_one_right_angle_turns_all_behind_it() -> None:
    body = _body([0.0, math.pi / 2, 0.0, 0.0, 0.0], l=1.0)
    expected = [(-1.0, 0.0), (-3.0, 0.0), *((-4.0, -1.0 - 2.0 * k) for k in range(4))]
    assert np.allclose(body.centres, expected, rtol=0, atol=1e-15)
    assert np.allclose(body.tail, (-4.0, -8.0), rtol=0, atol=1e-15)


@given(shapes, poses)
def test_places__in_the_world_are_the_oracles(
    phi: NDArray[np.float64], w: NDArray[np.float64]
) -> None:
    body = _body(phi)
    joints, centres, tail = oracle.joints_and_centres(w, phi, C)
    assert np.allclose(to_world(body.joints[1:], w), joints, rtol=0, atol=1e-14)
    assert np.allclose(to_world(body.centres, w), centres, rtol=0, atol=1e-14)
    assert np.allclose(to_world([body.tail], w), tail, rtol=0, atol=1e-14)
    theta = oracle.headings(np.zeros(3), phi)
    assert np.allclose(body.directions, np.c_[np.cos(theta), np.sin(theta)], rtol=0, atol=1e-14)


@given(shapes)
def test_links__are_2_l_long(phi: NDArray[np.float64]) -> None:
    body = _body(phi)
    ends = np.array([*body.joints, body.tail])
    assert np.allclose(np.linalg.norm(np.diff(ends, axis=0), axis=1), 2 * L, rtol=1e-13)
    assert np.allclose((ends[1:] + ends[:-1]) / 2, body.centres, rtol=0, atol=1e-14)


@given(shapes)
def test_mirrored_joints__mirror_the_body_to_the_bit(phi: NDArray[np.float64]) -> None:
    body, mirrored = _body(phi), _body(-phi)
    assert mirrored.centres == [(x, -y) for x, y in body.centres]
    assert mirrored.tail == (body.tail[0], -body.tail[1])
    assert d_min(-phi, L) == d_min(phi, L)


@pytest.mark.parametrize("n", [5, 8, 16])
def test_guarded_pairs__are_three_links_apart(n: int) -> None:
    pairs = guarded_pairs(n)
    assert set(pairs) == {(i, j) for i in range(1, n + 1) for j in range(1, n + 1) if j <= i - 3}
    assert len(pairs) == len(set(pairs)) == (n - 3) * (n - 2) // 2


@given(shapes, poses)
def test_distances__are_the_oracles_wherever_the_head_is(
    phi: NDArray[np.float64], w: NDArray[np.float64]
) -> None:
    body = _body(phi)
    expected = oracle.squared_distances(w, phi, C)
    ours = {pair: squared_distance(body, *pair) for pair in guarded_pairs(8)}
    assert ours == pytest.approx(expected, rel=0, abs=1e-13)
    assert d_min(phi, L) == pytest.approx(oracle.minimum_distance(w, phi, C), rel=0, abs=1e-9)


def test_guarded_points__are_centres_but_for_the_tail_tip() -> None:
    body = _body(np.linspace(-0.5, 0.9, 8))
    assert [body.guarded_point(i) for i in range(1, 8)] == body.centres[1:8]
    assert body.guarded_point(8) == body.tail


@pytest.mark.parametrize(
    ("phi", "distance"),
    [
        (np.zeros(8), 6 * L),  # W_1 to W_4
        (FOLDED, 2 * L),  # two legs side by side, one link between them
        ([0.0, math.pi / 2, math.pi / 2, math.pi / 2, 0.0], math.hypot(1, 1) * L),  # tail tip
    ],
)
def test_d_min__has_its_closed_forms(phi: list[float], distance: float) -> None:
    assert d_min(np.array(phi), L) == pytest.approx(distance, rel=1e-12)


def test_d_min__scales_with_the_links() -> None:
    assert d_min(FOLDED, 1.0) == pytest.approx(d_min(FOLDED, 0.25) * 4, rel=1e-12)


@given(shapes)
def test_centre_of_gravity__is_the_mean_of_all_links(phi: NDArray[np.float64]) -> None:
    body = _body(phi)
    assert np.allclose(centre_of_gravity(body), np.mean(body.centres, axis=0), rtol=0, atol=1e-15)
