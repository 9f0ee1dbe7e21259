"""Arithmetic on generic scalars: plain floats and traced code give the same bits."""

import math
import struct
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from snake_env.equations import scalars
from snake_env.equations.scalars import Scalar, sin_cos
from snake_env.equations.tracing import Trace
from snake_env.kernel import compiler
from snake_env.kernel.emission import emit

SPECIAL = [0.0, -0.0, 1.0, -1.0, 2.0, -3.5, 1e-310, -1e300, math.inf, -math.inf, math.nan]
MODERATE = st.floats(-1e6, 1e6)
QUADRANTS = [k * math.pi / 4 for k in (*range(-41, 42), 1001, 100_003, 999_999, 1_270_000)]


def _bits(value: float) -> bytes:
    return b"nan" if math.isnan(value) else struct.pack(">d", value)


def _compiled(
    function: Callable[..., Sequence[Scalar]], n_inputs: int, n_outputs: int, lanes: int = 8
) -> Callable[[np.ndarray], np.ndarray]:
    """The function traced and compiled: maps rows (n_inputs, lanes) to (n_outputs, lanes)."""
    trace = Trace()
    for row, value in enumerate(function(*[trace.lane(row) for row in range(n_inputs)])):
        trace.store(n_inputs + row, value)
    rows = n_inputs + n_outputs
    ir = emit(Trace(), trace, rows, 0, 1, lanes)
    assert lanes == 8 or "align 64" not in ir, "rows are not that well aligned: this may crash"
    run = compiler.load(ir, "a test")

    def call(values: np.ndarray) -> np.ndarray:
        raw = np.zeros(rows * lanes + 8)
        block = raw[-(raw.ctypes.data // 8) % 8 :][: rows * lanes].reshape(rows, lanes)
        block[:n_inputs] = values
        run(block.ctypes.data, 0, 0, 0, 1)
        return block[n_inputs:].copy()

    return call


def _mixed(a: Scalar, b: Scalar, c: Scalar) -> list[Scalar]:
    """Every operation of the module, on three scalars."""
    s = scalars
    conditions = [a < b, a <= b, a > b, a >= b, a == b]
    conditions += [s.both(a < b, b < c), s.either(a < b, b < c), s.negate(a < c)]
    conditions += [s.both(True, a < b), s.both(a < b, False), s.either(a < b, True)]
    values = [a + b, a - b, a * b, b - 1.5, 1.5 - b, 2.0 * c, c + 0.1, 1.0 + a, -a]
    values += [s.absolute(a), s.sqrt(s.absolute(b)), s.minimum(a, b), s.maximum(a, b)]
    values += [s.total([a, b, c]), s.dot([a, b], [b, c]), s.total([])]
    values += [s.select(condition, b, c) for condition in conditions]
    return values


N_MIXED = len(_mixed(1.0, 2.0, 3.0))


@pytest.mark.parametrize("lanes", [1, 8])
def test_arithmetic__gives_the_same_bits_traced_and_plain(lanes: int) -> None:
    call = _compiled(_mixed, 3, N_MIXED, lanes)
    rng = np.random.default_rng(0)
    for _ in range(300):
        values = rng.choice([*SPECIAL, *rng.normal(size=6)], size=(3, lanes))
        traced = call(values)
        for lane in range(lanes):
            plain = _mixed(*[float(x) for x in values[:, lane]])
            assert [_bits(x) for x in traced[:, lane]] == [_bits(float(x)) for x in plain]


def test_division__gives_the_same_bits_traced_and_plain() -> None:
    def quotients(a: Scalar, b: Scalar) -> list[Scalar]:
        return [a / b, 3.0 / b, a / 3.0]

    values = np.random.default_rng(0).normal(size=(2, 8)) * 10.0 ** np.arange(-4, 4)
    traced = _compiled(quotients, 2, 3)(values)
    assert traced.T.tolist() == [quotients(float(a), float(b)) for a, b in values.T]


def test_sin_cos__gives_the_same_bits_traced_and_plain() -> None:
    call = _compiled(sin_cos, 1, 2)
    rng = np.random.default_rng(1)
    wide = rng.uniform(-10, 10, 4000) * 10.0 ** rng.integers(-12, 6, 4000)
    values = np.concatenate([wide, QUADRANTS, SPECIAL, np.zeros(8)])
    for eight in values[: len(values) // 8 * 8].reshape(-1, 8):
        traced = call(eight[None])
        for lane, x in enumerate(eight):
            assert [_bits(y) for y in traced[:, lane]] == [
                _bits(float(y)) for y in sin_cos(float(x))
            ]


@given(st.one_of(MODERATE, st.floats(-math.pi, math.pi), st.floats(-1e-3, 1e-3)))
def test_sin_cos__is_as_exact_as_a_double_can_be(x: float) -> None:
    for ours, true in zip(sin_cos(x), (math.sin(x), math.cos(x)), strict=True):
        assert abs(ours - true) <= 2.3e-16
        assert abs(ours - true) <= 5e-16 * abs(true)


@pytest.mark.parametrize("side", [-1, 0, 1])
def test_sin_cos__is_exact_where_quadrants_meet(side: int) -> None:
    for angle in QUADRANTS:
        for step in range(5):
            x = angle + side * step * math.ulp(angle)
            for ours, true in zip(sin_cos(x), (math.sin(x), math.cos(x)), strict=True):
                assert abs(ours - true) <= min(2.3e-16, 5e-16 * abs(true))


def test_sin_cos__has_the_closed_forms_at_zero() -> None:
    assert sin_cos(0.0) == sin_cos(-0.0) == (0.0, 1.0)
    assert all(math.isnan(x) for x in sin_cos(math.nan))


@given(MODERATE)
def test_sin_cos__is_odd_and_even_to_the_bit(x: float) -> None:
    (sine, cosine), (mirrored_sine, mirrored_cosine) = sin_cos(x), sin_cos(-x)
    assert (mirrored_sine, mirrored_cosine) == (-sine, cosine)


def test_total__sums_from_left_to_right() -> None:
    assert scalars.total([1e16, 1.0, 1.0]) == 1e16
    assert scalars.total([1.0, 1.0, 1e16]) == 1e16 + 2.0
    assert scalars.dot([1e16, 1.0], [1.0, 1.0]) == 1e16


def test_trace__holds_each_distinct_operation_once() -> None:
    trace = Trace()
    a, b = trace.lane(0), trace.lane(1)
    assert (a + b).position == (b + a).position
    assert (a * b).position == (b * a).position
    assert (a - b).position != (b - a).position
    assert (a / b).position != (b / a).position
    assert (a + 1.0).position == (1.0 + trace.lane(0)).position
    assert len(trace.operations) == 10  # 2 lanes, a number, a + b, a * b, 2 each of -, /, a + 1


def test_traced_condition__has_no_truth_value() -> None:
    trace = Trace()
    with pytest.raises(TypeError, match=r"scalars\.select"):
        bool(trace.lane(0) < 1.0)
    with pytest.raises(TypeError, match="unhashable"):
        hash(trace.lane(0))
