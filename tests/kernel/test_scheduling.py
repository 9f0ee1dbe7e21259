"""The order of operations: a permutation that changes no result."""

from collections import Counter

import numpy as np

from snake_env.equations import scalars
from snake_env.equations.tracing import LEAVES, Trace, Traced
from snake_env.kernel.instant_mask import get_mask_kernel
from snake_env.kernel.interval import get_kernel
from snake_env.kernel.scheduling import scheduled
from tests.support.interpreter import interpret


def _computed(trace: Trace) -> list[str]:
    return [name for name, _ in trace.operations if name not in LEAVES]


def _random_trace(rng: np.random.Generator) -> Trace:
    trace = Trace()
    values: list[Traced] = [trace.lane(row) for row in range(4)]
    for _ in range(40):
        a, b, c = (values[k] for k in rng.integers(len(values), size=3))
        options = [a + b, a - 0.3, a * b, -a, scalars.minimum(a, b), scalars.select(a < b, c, a)]
        values.append(options[rng.integers(len(options))])
    for row, k in enumerate(rng.integers(len(values), size=6), start=4):
        trace.store(row, values[k])
    return trace


def test_scheduled_code__gives_the_same_bits() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        trace, lane = _random_trace(rng), rng.normal(size=4)
        assert interpret(scheduled(trace), lane) == interpret(trace, lane)


def test_schedule__holds_every_operation_once_and_operands_first() -> None:
    rng = np.random.default_rng(6)
    for trace in (*(_random_trace(rng) for _ in range(50)), get_kernel(5, True, 4).loop):
        ordered = scheduled(trace)
        assert Counter(_computed(ordered)) == Counter(_computed(trace))
        for position, (name, operands) in enumerate(ordered.operations):
            assert name in LEAVES or all(operand < position for operand in operands)


def _chain(trace: Trace, row: int, name: str, length: int) -> None:
    value = trace.lane(row)
    for step in range(length):
        value = value + float(step) if name == "fadd" else value * float(step + 2)
    trace.store(row, value)


def test_longest_way_to_a_result__is_begun_first() -> None:
    for lengths in ((3, 9), (9, 3)):
        trace = Trace()
        _chain(trace, 0, "fadd", lengths[0])
        _chain(trace, 1, "fmul", lengths[1])
        assert _computed(scheduled(trace))[0] == ("fmul" if lengths == (3, 9) else "fadd")


def test_last_user_of_a_value__comes_before_longer_ways() -> None:
    trace = Trace()
    a, b = trace.lane(0), trace.lane(1)
    root = a.sqrt()
    trace.store(2, (root - b).absolute())  # frees the root
    _chain(trace, 1, "fmul", 20)
    names = _computed(scheduled(trace))
    assert names.index("fsub") == names.index("sqrt") + 1
    assert names.index("fabs") == names.index("fsub") + 1


def test_loads__stand_just_before_their_first_use() -> None:
    for trace in (get_kernel(5, True, 4).loop, get_mask_kernel(5, True).last):
        for position, (name, _) in enumerate(trace.operations):
            if name in LEAVES:
                following = (p for p in trace.operations[position:] if p.name not in LEAVES)
                stored = any(place == position for _, place in trace.stores)
                assert stored or position in next(following).operands
