"""Rules that rewrite traces: each one alone, and all of them on the kernel and on random code."""

import math
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from snake_env.equations import scalars
from snake_env.equations.rewriting import rewritten
from snake_env.equations.tracing import Trace, Traced
from snake_env.kernel.blocks import constants_of, traced_params
from snake_env.kernel.interval import get_kernel
from snake_env.params import SnakeParams
from tests.support.interpreter import interpret

Rule = Callable[..., Traced]
SELECTED = scalars.select


def _rewritten(function: Rule, n_inputs: int = 4) -> Trace:
    """What the rules make of a function of lanes; its result goes to the row after them."""
    trace = Trace()
    trace.store(n_inputs, function(*[trace.lane(row) for row in range(n_inputs)]))
    return rewritten(trace)


def _names(trace: Trace) -> dict[str, int]:
    """How many operations of each kind a trace has, loads and numbers aside."""
    names = Counter(operation.name for operation in trace.operations)
    return {name: n for name, n in names.items() if name not in ("lane", "shared", "number")}


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda a, b, c, d: a * b + c, {"fma": 1}),
        (lambda a, b, c, d: c + a * b, {"fma": 1}),
        (lambda a, b, c, d: c - a * b, {"fnma": 1}),
        (lambda a, b, c, d: a * b - c, {"fms": 1}),
        (lambda a, b, c, d: -(a * b) - c, {"fnms": 1}),
        (lambda a, b, c, d: c + (-a) * b, {"fnma": 1}),
        (lambda a, b, c, d: c - (-a) * b, {"fma": 1}),
        (lambda a, b, c, d: (-c) + a * b, {"fms": 1}),
        (lambda a, b, c, d: a * b + c * d, {"fmul": 1, "fma": 1}),
        (lambda a, b, c, d: a * b - c * d, {"fmul": 1, "fnma": 1}),
        (lambda a, b, c, d: (a * b + c) * (a * b + d), {"fma": 2, "fmul": 1}),
        (lambda a, b, c, d: (a * b) * (a * b + d), {"fma": 1, "fmul": 2}),
    ],
)
def test_product__becomes_part_of_the_sum(function: Rule, expected: dict[str, int]) -> None:
    assert _names(_rewritten(function)) == expected


def test_product__is_rounded_once_with_the_sum() -> None:
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    trace = _rewritten(lambda a, b, c, d: a * b - c)
    assert interpret(trace, [a, b, 1.0, 0.0]) == {4: -(2.0**-60)}
    assert a * b - 1.0 == 0.0


def test_right_product__is_fused_whichever_was_there_first() -> None:
    for late in (False, True):
        trace = Trace()
        a, b, c, d = (trace.lane(row) for row in range(4))
        if late:
            c * d
        trace.store(4, a * b + c * d)
        lane = [1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0, 1.0]
        assert interpret(rewritten(trace), lane) == {4: 0.0}
        assert interpret(rewritten(trace), [*lane[2:], *lane[:2]]) == {4: -(2.0**-60)}


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda a, b, c, d: a + -b, {"fsub": 1}),
        (lambda a, b, c, d: -a + b, {"fsub": 1}),
        (lambda a, b, c, d: a - -b, {"fadd": 1}),
        (lambda a, b, c, d: (-a) * (-b), {"fmul": 1}),
        (lambda a, b, c, d: (-a) / b + c, {"fdiv": 1, "fsub": 1}),
        (lambda a, b, c, d: (lambda x: -x)(-a) + b, {"fadd": 1}),
        (lambda a, b, c, d: (-a).absolute(), {"fabs": 1}),
        (lambda a, b, c, d: SELECTED(a < b, -c, -d) + a, {"olt": 1, "select": 1, "fsub": 1}),
        (lambda a, b, c, d: a * scalars.select(a < b, -c, c), None),
    ],
)
def test_negation__is_folded(function: Rule, expected: dict[str, int] | None) -> None:
    names = _names(_rewritten(function))
    assert names.get("fneg", 0) == 0 if expected else names["fneg"] == 1
    assert expected in (None, names)


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda a, b, c, d: a / b, {"fdiv": 1}),
        (lambda a, b, c, d: a / 3.0, {"fdiv": 1, "fmul": 1}),  # 1 / 3 is the same for all lanes
        (lambda a, b, c, d: 1.0 / b, {"fdiv": 1}),
        (lambda a, b, c, d: (a / b) * (c / b), {"fdiv": 1, "fmul": 3}),
        (lambda a, b, c, d: (a / b) + (c / b), {"fdiv": 1, "fmul": 1, "fma": 1}),
        (lambda a, b, c, d: (a / b) * (c / d), {"fdiv": 2, "fmul": 1}),
    ],
)
def test_repeated_divisor__is_inverted_once(function: Rule, expected: dict[str, int]) -> None:
    assert _names(_rewritten(function)) == expected


def test_division_by_a_constant__is_a_product() -> None:
    trace = Trace()
    p = traced_params(trace, True)
    trace.store(1, trace.lane(0) / p.l + trace.lane(0) / (2.0 * p.l))
    assert _names(rewritten(trace)) == {"fdiv": 2, "fmul": 2, "fma": 1}


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda a, b, c, d: SELECTED(a < b, c, c), {}),
        (lambda a, b, c, d: SELECTED(~(a < b), c, d), {"olt": 1, "select": 1}),
        (lambda a, b, c, d: SELECTED(~~(a < b), c, d), {"olt": 1, "select": 1}),
        (lambda a, b, c, d: SELECTED(a < b, c, SELECTED(a < b, a, d)), {"olt": 1, "select": 1}),
        (lambda a, b, c, d: SELECTED(a < b, SELECTED(a < b, c, a), d), {"olt": 1, "select": 1}),
        (
            lambda a, b, c, d: SELECTED(a < b, c, SELECTED(a < c, c, d)),
            {"olt": 2, "or": 1, "select": 1},
        ),
        (
            lambda a, b, c, d: SELECTED(a < b, SELECTED(a < c, c, d), d),
            {"olt": 2, "and": 1, "select": 1},
        ),
    ],
)
def test_choices__are_merged(function: Rule, expected: dict[str, int]) -> None:
    trace = _rewritten(function)
    assert _names(trace) == expected
    plain = Trace()
    plain.store(4, function(*[plain.lane(row) for row in range(4)]))
    for lane in np.random.default_rng(0).integers(0, 3, size=(50, 4)).astype(float):
        assert interpret(trace, lane) == interpret(plain, lane)


def test_rewriting__leaves_out_what_no_result_needs() -> None:
    trace = Trace()
    a, b = trace.lane(0), trace.lane(1)
    (a * b).sqrt()
    trace.store(2, a)
    assert [operation.name for operation in rewritten(trace).operations] == ["lane"]


def test_rewriting__changes_the_kernels_results_by_rounding_only() -> None:
    kernel = get_kernel(5, True, 4)
    assert "fma" in _names(kernel.loop)
    for trace in (kernel.loop, kernel.last):
        again = rewritten(trace)  # nothing is left to do
        assert _names(again) == _names(trace)


def test_rewritten_code__gives_what_the_plain_code_gives_but_for_rounding() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        trace = Trace()
        values = [trace.lane(row) for row in range(4)]
        for _ in range(30):
            a, b, c = (values[k] for k in rng.integers(len(values), size=3))
            options = [a + b, a - b, a * b, -a, scalars.minimum(a, b), SELECTED(a < b, c, a)]
            values.append(options[rng.integers(len(options))] * 0.7)
        for row, value in enumerate(values[-5:], start=4):
            trace.store(row, value)
        lane = rng.normal(size=4)
        plain, fused = interpret(trace, lane), interpret(rewritten(trace), lane)
        assert fused == pytest.approx(plain, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
def test_compiled_kernel__gives_the_bits_of_its_trace(lanes: int) -> None:
    params = SnakeParams(n_joints=5)
    kernel = get_kernel(5, True, lanes)
    blocks = kernel.blocks(lanes)
    blocks[:] = np.random.default_rng(4).uniform(-0.8, 0.8, (1, kernel.n_rows, lanes))
    blocks[0, kernel.rows["violation"]] = 0.0
    blocks[0, kernel.rows["phase"]] = 1.0
    blocks[0, kernel.rows["grounded"]] = [[0.0], [1.0], [0.0], [1.0], [1.0]]
    blocks[0, kernel.rows["wheels"]] = [[3.0]]
    blocks[0, kernel.rows["d2_min"]] = math.inf
    constants, clock = constants_of(params), np.array([[0.7, 1.3]])
    expected = blocks[0].copy()
    for lane in range(lanes):
        for trace in (kernel.loop, kernel.last):
            for row, value in interpret(trace, expected[:, lane], constants, clock[0]).items():
                expected[row, lane] = value
    kernel.run(blocks, constants, clock)
    assert blocks[0].tobytes() == expected.tobytes()
