"""Static stability (22): closed forms, exact integer geometry, the oracle's convex hull."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from snake_env.equations.kinematics import Body, locate
from snake_env.equations.stability import contacts, statically_stable
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.simulation import instantly_stable
from snake_env.state import StateBatch
from tests.support import oracle
from tests.support.robots import (
    NARROW,
    PAPER,
    oracle_constants,
    random_state,
    seeds,
    shapes,
    straight_state,
)

GRID = SnakeParams(n_joints=7, track=2.0)  # 8 links: the mean of small integers is exact
marks = st.lists(st.booleans(), min_size=8, max_size=8)
cells = st.tuples(st.integers(-3, 3), st.integers(-3, 3))


def _stable(phi: object, grounded: list[bool], params: SnakeParams = PAPER) -> bool:
    body = locate([float(angle) for angle in np.asarray(phi)], params.l)
    return bool(statically_stable(body, grounded, params))


def _grounded(*wheels: int, n: int = 8) -> list[bool]:
    return [k in wheels for k in range(1, n + 1)]


def _surrounded(points: list[tuple[int, int]]) -> bool:
    """Whether the origin is strictly inside the hull: no line through it has all on one side."""
    turns = [[px * qy - py * qx for qx, qy in points] for px, py in points if (px, py) != (0, 0)]
    return bool(turns) and all(min(row) < 0 < max(row) for row in turns)


@pytest.mark.parametrize(
    ("wheels", "stable"),
    [
        ((1, 2, 3, 4, 5, 6, 7, 8), True),
        ((6, 7, 8), True),  # link 0 rests in front
        ((1, 8), True),
        ((1, 2, 3), False),  # all in front of the centre of gravity, W_4
        ((5,), True),
        ((), False),
    ],
)
def test_straight_robot__stands_on_wheels_around_its_middle(
    wheels: tuple[int, ...], stable: bool
) -> None:
    assert _stable(np.zeros(8), _grounded(*wheels)) is stable


def test_narrow_robot__needs_wheels_in_front() -> None:
    assert _stable(np.zeros(8), _grounded(5, 6, 7))
    assert not _stable(np.zeros(8), _grounded(5, 6, 7), NARROW)
    assert _stable(np.zeros(8), _grounded(3, 6, 7), NARROW)


def test_centre_of_gravity__on_the_edge_is_not_stable() -> None:
    zero = (0.0, 0.0)
    body = Body([(1.0, 0.0)] * 8, [zero] * 8, [(-2.0, -1.0), (2.0, 0.0), *[zero] * 6], zero)
    body.centres[2] = (0.0, 1.0)
    assert not statically_stable(body, _grounded(1, n=7), GRID)  # between W_0 and a left wheel
    body.centres[2], body.centres[7] = (2.0, -2.0), (-2.0, 3.0)
    assert not statically_stable(body, _grounded(1, n=7), GRID)
    assert statically_stable(body, _grounded(1, 7, n=7), GRID)


def test_contacts_in_a_row__carry_nothing() -> None:
    zero = (0.0, 0.0)
    body = Body([(1.0, 0.0)] * 8, [zero] * 8, [(0.0, -3.0), zero, (0.0, 3.0), *[zero] * 5], zero)
    assert not statically_stable(body, _grounded(1, 2, n=7), GRID)


def test_track__widens_the_support() -> None:
    phi = [0.5] * 8
    grounded = _grounded(1, 2, 8)
    stable = [_stable(phi, grounded, PAPER.replace(track=track)) for track in (0.01, 2.0)]
    assert stable == [False, True]


def test_contacts__are_link_0_and_both_wheels_of_each_axle() -> None:
    body = locate([0.0] * 8, PAPER.l)
    points = contacts(body, PAPER)
    assert [k for k, _ in points] == [0, *(k for k in range(1, 9) for _ in range(2))]
    assert points[0][1] == (-PAPER.l, 0.0)
    for k in range(1, 9):
        (_, left), (_, right) = points[2 * k - 1 : 2 * k + 1]
        assert left == pytest.approx((-PAPER.l * (2 * k + 1), 0.05), rel=1e-14)
        assert right == pytest.approx((-PAPER.l * (2 * k + 1), -0.05), rel=1e-14)
    assert contacts(body, NARROW) == points[1:]


@given(shapes, marks, st.booleans())
def test_stability__is_the_oracles(
    phi: NDArray[np.float64], grounded: list[bool], head_contact: bool
) -> None:
    params = PAPER.replace(head_contact=head_contact)
    assume(head_contact or any(grounded))
    lifted = ~np.array(grounded)
    margin = oracle.stability_margin(np.zeros(3), phi, lifted, oracle_constants(params))
    assume(abs(margin) > 1e-9)
    assert _stable(phi, grounded, params) == (margin > 0)


def test_stability__is_the_oracles_over_many_shapes() -> None:
    rng = np.random.default_rng(0)
    constants, seen = oracle_constants(NARROW), {True: 0, False: 0}
    for _ in range(400):
        phi, grounded = rng.uniform(-1.5, 1.5, 8), rng.random(8) < 0.5
        if grounded.any():
            stable = oracle.stable(np.zeros(3), phi, ~grounded, constants)
            assert _stable(phi, grounded.tolist(), NARROW) == stable
            seen[stable] += 1
    assert min(seen.values()) > 50


def _assert_exact(centres: list[tuple[int, int]], grounded: list[bool], head: bool) -> None:
    """Compares with integer arithmetic: all links point along x, wheels are 1 beside them."""
    places = [(float(x), float(y)) for x, y in centres]
    body = Body([(1.0, 0.0)] * 8, [(0.0, 0.0)] * 8, places, (0.0, 0.0))
    sx, sy = (sum(axis) for axis in zip(*centres, strict=True))
    touching = [
        (8 * x - sx, 8 * (y + side) - sy)
        for k, (x, y) in enumerate(centres)
        for side in ((0,) if k == 0 else (-1, 1))
        if (head if k == 0 else grounded[k - 1])
    ]
    stable = statically_stable(body, grounded, GRID.replace(head_contact=head))
    assert stable == _surrounded(touching)


@settings(max_examples=300)
@given(st.lists(cells, min_size=8, max_size=8), st.lists(st.booleans(), min_size=7, max_size=7),
       st.booleans())  # fmt: skip
def test_stability__is_exact_on_a_grid(
    centres: list[tuple[int, int]], grounded: list[bool], head: bool
) -> None:
    _assert_exact(centres, grounded, head)


def test_stability__is_exact_where_the_second_contact_is_just_opposite_the_first() -> None:
    centres = [(4, 0), (-4, -1), (8, 0), (-8, 1), *[(0, 0)] * 4]
    _assert_exact(centres, [True, True] + [False] * 5, True)


@given(shapes, marks)
def test_mirrored_shape__is_as_stable(phi: NDArray[np.float64], grounded: list[bool]) -> None:
    lifted = ~np.array(grounded)
    margin = oracle.stability_margin(np.zeros(3), phi, lifted, oracle_constants(PAPER))
    assume(abs(margin) > 1e-9)
    assert _stable(phi, grounded) == _stable(-phi, grounded)


@given(seeds)
def test_instant_mask__is_stability_at_t_k(seed: int) -> None:
    state = random_state(seed)
    modes = mode_table(8).valid(state.phase)
    batch = StateBatch.stack([state] * len(modes))
    grounded = ~mode_table(8).lifted[modes]
    grounded[:, state.phase - 1] = False
    expected = [_stable(state.phi, row.tolist(), NARROW) for row in grounded]
    assert instantly_stable(batch, modes, NARROW).tolist() == expected


def test_instant_mask__refuses_some_modes_of_a_narrow_robot() -> None:
    batch = StateBatch.stack([straight_state(NARROW)] * 99)
    stable = instantly_stable(batch, np.arange(99), NARROW)
    assert stable.any()
    assert not stable.all()
    assert not stable[mode_table(8).index([2, 3, 4])]
