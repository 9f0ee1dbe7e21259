"""The modes: their number, their order, which phase allows which, and what is refused."""

import math
from itertools import pairwise

import numpy as np
import pytest

from snake_env.errors import InvalidInputError, InvalidModeError
from snake_env.modes import ModeTable, mode_table
from snake_env.sim.simulation import advance, predict, predict_batch
from snake_env.state import StateBatch
from tests.support import oracle
from tests.support.robots import PAPER, straight_state

ALL_N = range(5, 17)
TABLE = mode_table(8)


def _wheels(table: ModeTable, mode: int) -> tuple[int, ...]:
    return tuple(int(k) + 1 for k in np.flatnonzero(table.lifted[mode]))


def test_counts__are_the_papers() -> None:
    assert len(TABLE) == 99
    assert [int(TABLE.mask(phase).sum()) for phase in range(1, 9)] == [99, 57, 31, 16, 8, 4, 2, 1]


@pytest.mark.parametrize("n", ALL_N)
def test_counts__follow_the_binomials(n: int) -> None:
    table = mode_table(n)
    for phase in range(1, n + 1):
        most = min(n - phase, n - 4)
        assert len(table.valid(phase)) == sum(math.comb(n - phase, k) for k in range(most + 1))


@pytest.mark.parametrize("n", ALL_N)
def test_modes__go_to_wheels_and_back(n: int) -> None:
    table = mode_table(n)
    for mode in range(len(table)):
        wheels = _wheels(table, mode)
        assert table.index(wheels) == table.index(reversed(wheels)) == mode
        assert tuple(int(k) for k in table.wheels[mode] if k) == wheels
        assert table.n_lifted[mode] == len(wheels)


@pytest.mark.parametrize("n", ALL_N)
def test_order__is_by_count_then_by_wheel_number(n: int) -> None:
    table = mode_table(n)
    keys = [(len(wheels), wheels) for wheels in (_wheels(table, m) for m in range(len(table)))]
    assert all(a < b for a, b in pairwise(keys))
    assert keys[0] == (0, ())
    assert [wheels for _, wheels in keys[1:n]] == [(k,) for k in range(2, n + 1)]


@pytest.mark.parametrize("n", range(5, 11))
def test_mask__allows_what_the_oracle_allows_in_its_order(n: int) -> None:
    table = mode_table(n)
    for phase in range(1, n + 1):
        lifted = table.lifted[table.valid(phase)].copy()
        lifted[:, phase - 1] = True
        assert np.array_equal(lifted, oracle.valid_modes(phase, n))


@pytest.mark.parametrize("n", ALL_N)
def test_mask__keeps_front_wheels_grounded(n: int) -> None:
    table = mode_table(n)
    for phase in range(1, n + 1):
        assert not table.lifted[table.mask(phase), :phase].any()


@pytest.mark.parametrize("n", ALL_N)
def test_mask__keeps_three_wheels_grounded(n: int) -> None:
    table = mode_table(n)
    for phase in range(1, n + 1):
        grounded = ~table.lifted[table.mask(phase)]
        grounded[:, phase - 1] = False
        assert grounded.sum(axis=1).min() >= 3


def test_mask__is_empty_once_the_target_is_reached() -> None:
    assert not TABLE.mask(9).any()


def test_masks__are_those_of_each_phase() -> None:
    phases = np.array([3, 1, 9, 8, 3])
    assert np.array_equal(TABLE.masks(phases), [TABLE.mask(int(phase)) for phase in phases])


@pytest.mark.parametrize("mode", [0, np.int64(98), np.uint8(7)])
def test_check__returns_a_plain_integer(mode: int) -> None:
    assert TABLE.check(mode, 1) == mode
    assert type(TABLE.check(mode, 1)) is int


@pytest.mark.parametrize("mode", [-1, 99, 10**30, 1.0, True, None, "1", math.nan, np.array(1.5)])
def test_check__refuses_what_is_no_mode(mode: object) -> None:
    with pytest.raises(InvalidModeError, match=r"^mode = .*an integer from 0 to 98") as caught:
        TABLE.check(mode, 1)  # type: ignore[arg-type]
    assert caught.value.field == "mode"


def test_check__refuses_modes_that_the_phase_does_not_allow() -> None:
    mode = TABLE.index([3, 8])
    assert TABLE.check(mode, 2) == mode
    for phase in (3, 4, 8):
        with pytest.raises(InvalidModeError, match=rf"^mode = {mode}: .*valid in phase {phase}"):
            TABLE.check(mode, phase)
    with pytest.raises(InvalidModeError, match="this one lifts 3, 8"):
        TABLE.check(mode, 3)
    with pytest.raises(InvalidModeError, match="target is reached"):
        TABLE.check(0, 9)


@pytest.mark.parametrize("phase", [0, 10, -1, math.nan, 1.5])
def test_mask__refuses_phases_out_of_range(phase: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^phase = .*an integer from 1 to 9"):
        TABLE.mask(phase)  # type: ignore[arg-type]


@pytest.mark.parametrize("wheels", [[1], [9], [0], [2, 2], [2, 3, 4, 5, 6], [2.5]])
def test_index__refuses_wheels_that_no_mode_lifts(wheels: list[int]) -> None:
    with pytest.raises(InvalidModeError, match=r"^wheels = .*at most 4 different wheels"):
        TABLE.index(wheels)


@pytest.mark.parametrize("n", [4, 17, -1, 0, True, 8.0, "8"])
def test_table__refuses_robots_out_of_range(n: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^n_joints = .*an integer from 5 to 16"):
        ModeTable(n)  # type: ignore[arg-type]


@pytest.mark.parametrize("modes", [[99], [-1], [0, 10**30], [0.0], [True], ["1"], [None]])
def test_predict__refuses_what_are_no_modes(modes: object) -> None:
    with pytest.raises(InvalidModeError, match=r"^modes? = .*integer"):
        predict(straight_state(), modes, PAPER)  # type: ignore[arg-type]


@pytest.mark.parametrize("modes", [[[0]], 0, None])
def test_predict__refuses_modes_of_a_wrong_shape(modes: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^modes\.shape = .*one dimension"):
        predict(straight_state(), modes, PAPER)  # type: ignore[arg-type]


def test_predict__refuses_modes_of_another_phase() -> None:
    state, mode = straight_state().replace(phase=4), mode_table(8).index([4, 6])
    for run in (lambda: predict(state, [0, mode], PAPER), lambda: advance(state, mode, PAPER)):
        with pytest.raises(InvalidModeError, match=rf"^mode = {mode}: .*valid in phase 4"):
            run()
    with pytest.raises(InvalidModeError, match="target is reached"):
        predict(state.replace(phase=9), [0], PAPER)


def test_predict_batch__refuses_another_number_of_modes() -> None:
    with pytest.raises(InvalidInputError, match=r"^modes = 3: expected one mode for each of 2"):
        predict_batch(StateBatch.stack([straight_state()] * 2), [0, 0, 0], PAPER)
