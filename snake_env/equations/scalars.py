"""Arithmetic on generic scalars: a plain ``float``, or a value traced into the kernel.

The equations of the paper are written once, as ordinary functions of scalars. Given floats they
compute numbers; given :class:`snake_env.equations.tracing.Traced` values they record the kernel's code.
Both perform the same IEEE operations in the same order. Programs run what was recorded rewritten by
:mod:`snake_env.equations.rewriting`: sums take products in, rounded once. So floats agree with the
kernel to rounding; whatever must agree bit for bit runs compiled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

from snake_env.equations.tracing import Traced, TracedBool

Scalar: TypeAlias = float | Traced
Bool: TypeAlias = bool | TracedBool

# Coefficients of x^1, x^3, ... and of x^0, x^2, ...: within 2^-58 of sine and cosine on [-pi/4, pi/4].
# The minimax polynomials of fdlibm (k_sin.c, k_cos.c), one term shorter than Taylor's.
_SIN_TERMS = (
    1.0,
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS_TERMS = (
    1.0,
    -0.5,
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
# pi/2 in three parts (33 + 33 + 53 bits), so that x - q pi/2 stays exact to 1e-16 for |q| < 2^20.
_HALF_PI_PARTS = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding and subtracting it rounds to an integer


def sqrt(x: Scalar) -> Scalar:
    """Square root, correctly rounded."""
    return math.sqrt(x) if isinstance(x, float) else x.sqrt()


def absolute(x: Scalar) -> Scalar:
    """Absolute value."""
    return abs(x) if isinstance(x, float) else x.absolute()


def select(condition: Bool, if_true: Scalar, if_false: Scalar) -> Scalar:
    """``if_true`` where the condition holds, else ``if_false``: both are evaluated."""
    if isinstance(condition, bool):
        return if_true if condition else if_false
    return condition.select(if_true, if_false)


def both(a: Bool, b: Bool) -> Bool:
    """Logical and of plain or traced conditions."""
    if isinstance(a, bool):
        return b if a else False
    if isinstance(b, bool):
        return a if b else False
    return a & b


def negate(a: Bool) -> Bool:
    """Logical not of a plain or traced condition."""
    return (not a) if isinstance(a, bool) else ~a


def either(a: Bool, b: Bool) -> Bool:
    """Logical or of plain or traced conditions."""
    if isinstance(a, bool):
        return True if a else b
    if isinstance(b, bool):
        return True if b else a
    return a | b


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """The smaller of two scalars."""
    return select(a < b, a, b)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger of two scalars."""
    return select(a > b, a, b)


def total(values: Sequence[Scalar]) -> Scalar:
    """Sum from left to right; 0.0 for no values."""
    result: Scalar = 0.0
    for position, value in enumerate(values):
        result = value if position == 0 else result + value
    return result


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """Inner product, summed from left to right."""
    return total([x * y for x, y in zip(a, b, strict=True)])


def _polynomial(terms: Sequence[float], x: Scalar) -> Scalar:
    result: Scalar = terms[-1]
    for term in reversed(terms[:-1]):
        result = result * x + term
    return result


def sin_cos(x: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine to about 2e-16, for ``|x|`` up to a million.

    The argument is reduced to ``[-pi/4, pi/4]``. Quarter turns are put back by the angle sum, whose
    factors are 0, 1 and -1 then: exact, and cheaper than choices. Neither NumPy's nor the C library's
    version is used: they differ between machines.
    """
    quarter = (x * (2.0 / math.pi) + _ROUND) - _ROUND
    r = x
    for part in _HALF_PI_PARTS:
        r = r - quarter * part
    r2 = r * r
    sine = r * _polynomial(_SIN_TERMS, r2)
    cosine = _polynomial(_COS_TERMS, r2)
    turn = quarter - 4.0 * ((quarter * 0.25 + _ROUND) - _ROUND)  # quarter modulo 4, in -2..2
    cos_turn = 1.0 - absolute(turn)
    sin_turn = turn + turn * cos_turn
    return cos_turn * sine + sin_turn * cosine, cos_turn * cosine - sin_turn * sine
