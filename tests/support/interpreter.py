"""Runs a trace on plain numbers, one lane at a time: what the compiled code must give bit for bit."""

import math
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction

from snake_env.equations.tracing import Trace


def fma(a: float, b: float, c: float) -> float:
    """``a b + c``, rounded once."""
    if not all(map(math.isfinite, (a, b, c))):
        return c if math.isfinite(a) and math.isfinite(b) else a * b + c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    if exact == 0:  # of which sign, the sum of a zero product's sign and c tells
        return a * b + c if 0 in (a, b) else 0.0
    try:
        return float(exact)  # correctly rounded
    except OverflowError:
        return math.copysign(math.inf, exact)


def _divide(a: float, b: float) -> float:
    if b == 0:
        return (
            math.nan
            if a == 0 or math.isnan(a)
            else math.copysign(math.inf, a) * math.copysign(1, b)
        )
    return a / b


_FUNCTIONS: dict[str, Callable[..., float | bool]] = {
    "fadd": operator.add,
    "fsub": operator.sub,
    "fmul": operator.mul,
    "fdiv": _divide,
    "fneg": operator.neg,
    "fabs": abs,
    "sqrt": lambda x: math.sqrt(x) if x >= 0 else math.nan,
    "fma": fma,
    "fnma": lambda a, b, c: fma(-a, b, c),
    "fms": lambda a, b, c: fma(a, b, -c),
    "fnms": lambda a, b, c: fma(-a, b, -c),
    "olt": operator.lt,
    "ole": operator.le,
    "ogt": operator.gt,
    "oge": operator.ge,
    "oeq": operator.eq,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "select": lambda condition, x, y: x if condition else y,
}


def interpret(
    trace: Trace, lane: Sequence[float], shared: Sequence[float] = (), clock: Sequence[float] = ()
) -> dict[int, float]:
    """What the trace stores, by row.

    Args:
        trace: The operations.
        lane: The lane's rows.
        shared: The constants.
        clock: The clock's row.
    """
    rows = {"lane": lane, "shared": shared, "clock": clock}
    values: list[float | bool] = []
    for name, operands in trace.operations:
        if name == "number":
            values.append(operands[0])
        elif name in rows:
            values.append(float(rows[name][int(operands[0])]))
        else:
            values.append(_FUNCTIONS[name](*(values[int(operand)] for operand in operands)))
    return {row: values[position] for row, position in trace.stores}
