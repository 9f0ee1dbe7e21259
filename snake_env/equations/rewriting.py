"""Rewrites a trace so that it needs fewer and shorter operations.

Each rule looks at one operation and at what its operands are, never at the lanes, at the width of a
block or at the processor: every program that evaluates an equation gets the same code for it, and so
the same bits. Two rules change a result's last bit, always towards less rounding or by one rounding:

* A product that is added or subtracted becomes part of a fused multiply-add, rounded once. The product
  itself stays only if something else needs it. Of two products the right one is fused.
* A division by something that is the same for all lanes, or that divides more than once, becomes a
  product with one reciprocal.

All other rules are exact: negations move outward until a sum or a fused operation absorbs them,
choices between equal things vanish, nested ones become one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from snake_env.equations.tracing import LEAVES, Trace

FUSED = ("fma", "fnma", "fms", "fnms")
"""``a b + c``, ``c - a b``, ``a b - c`` and ``-a b - c``, each rounded once."""


def rewritten(trace: Trace) -> Trace:
    """A trace that stores the same results, without what no result needs."""
    return _Rewriter(trace).rewritten()


def needed(trace: Trace) -> list[int]:
    """Positions of the operations that the results depend on, in order."""
    wanted = {position for _, position in trace.stores}
    for position in range(len(trace.operations) - 1, -1, -1):
        operation = trace.operations[position]
        if position in wanted and operation.name not in LEAVES:
            wanted.update(int(operand) for operand in operation.operands)
    return sorted(wanted)


class _Rewriter:
    def __init__(self, trace: Trace) -> None:
        self._old, self._new = trace, Trace()
        self._uniform: set[int] = set()  # positions in the new trace: the same for all lanes
        self._divisions: Counter[int] = Counter()  # by position of the divisor in the new trace
        self._rules: dict[str, Callable[..., int]] = {
            "fadd": self._sum,
            "fsub": self._difference,
            "fmul": self._product,
            "fdiv": self._quotient,
            "fneg": self._negation,
            "fabs": self._size,
            "select": self._choice,
            "not": self._opposite,
        }

    def rewritten(self) -> Trace:
        places: dict[int, int] = {}
        live = needed(self._old)
        divisors = Counter(
            int(self._old.operations[p].operands[1])
            for p in live
            if self._old.operations[p].name == "fdiv"
        )
        for position in live:
            name, operands = self._old.operations[position]
            if name in LEAVES:
                places[position] = self._record(name, *operands)
                continue
            mapped = [places[int(operand)] for operand in operands]
            if name == "fdiv":
                self._divisions[mapped[1]] = divisors[int(operands[1])]
            rule = self._rules.get(name)
            places[position] = rule(*mapped) if rule else self._record(name, *mapped)
        self._new.stores = [(row, places[position]) for row, position in self._old.stores]
        return self._new.in_order(needed(self._new))

    def _record(self, name: str, *operands: int | float) -> int:
        position = self._new.record(name, *operands)
        if name in ("number", "shared") or (
            name not in LEAVES and all(int(operand) in self._uniform for operand in operands)
        ):
            self._uniform.add(position)
        return position

    def _is(self, position: int, name: str) -> bool:
        return self._new.operations[position].name == name

    def _operands(self, position: int) -> tuple[int, ...]:
        return tuple(int(operand) for operand in self._new.operations[position].operands)

    def _factors(self, position: int) -> tuple[int, int, bool] | None:
        """Factors of a product that varies with the lanes, and whether it is negated."""
        negated = self._is(position, "fneg")
        product = self._operands(position)[0] if negated else position
        if not self._is(product, "fmul") or product in self._uniform:
            return None
        a, b = self._operands(product)
        return a, b, negated

    def _sum(self, x: int, y: int) -> int:
        for product, other in ((y, x), (x, y)):
            factors = self._factors(product)
            if factors:
                a, b, negated = factors
                return self._fused(a, b, other, negated, False)
        for subtracted, other in ((y, x), (x, y)):
            if self._is(subtracted, "fneg"):
                return self._record("fsub", other, self._operands(subtracted)[0])
        return self._record("fadd", x, y)

    def _difference(self, x: int, y: int) -> int:
        factors = self._factors(y)
        if factors:
            return self._fused(factors[0], factors[1], x, not factors[2], False)
        factors = self._factors(x)
        if factors:
            return self._fused(factors[0], factors[1], y, factors[2], True)
        if self._is(y, "fneg"):
            return self._sum(x, self._operands(y)[0])
        return self._record("fsub", x, y)

    def _fused(self, a: int, b: int, c: int, negated: bool, subtracted: bool) -> int:
        """``a b + c``, its product negated or ``c`` subtracted."""
        if self._is(c, "fneg"):
            c, subtracted = self._operands(c)[0], not subtracted
        return self._record(FUSED[2 * subtracted + negated], min(a, b), max(a, b), c)

    def _product(self, x: int, y: int) -> int:
        x, x_negated = self._unsigned(x)
        y, y_negated = self._unsigned(y)
        product = self._record("fmul", x, y)
        return self._negation(product) if x_negated != y_negated else product

    def _quotient(self, x: int, y: int) -> int:
        y, y_negated = self._unsigned(y)
        x, x_negated = self._unsigned(x)
        is_one = self._new.operations[x] == ("number", (1.0,))
        if (self._divisions[y] > 1 or y in self._uniform) and not is_one:
            quotient = self._record("fmul", x, self._record("fdiv", self._one(), y))
        else:
            quotient = self._record("fdiv", x, y)
        return self._negation(quotient) if x_negated != y_negated else quotient

    def _one(self) -> int:
        return self._record("number", 1.0)

    def _unsigned(self, x: int) -> tuple[int, bool]:
        """What is negated, and that it is; or the value itself."""
        return (self._operands(x)[0], True) if self._is(x, "fneg") else (x, False)

    def _negation(self, x: int) -> int:
        if self._is(x, "fneg"):
            return self._operands(x)[0]
        if self._is(x, "number"):
            return self._record("number", -self._new.operations[x].operands[0])
        return self._record("fneg", x)

    def _size(self, x: int) -> int:
        return self._record("fabs", self._unsigned(x)[0])

    def _opposite(self, condition: int) -> int:
        if self._is(condition, "not"):
            return self._operands(condition)[0]
        return self._record("not", condition)

    def _choice(self, condition: int, x: int, y: int) -> int:
        if self._is(condition, "not"):
            return self._choice(self._operands(condition)[0], y, x)
        if x == y:
            return x
        if self._is(x, "fneg") and self._is(y, "fneg"):
            a, b = self._operands(x)[0], self._operands(y)[0]
            return self._negation(self._choice(condition, a, b))
        if self._is(y, "select"):
            inner, a, b = self._operands(y)
            if inner == condition:  # the inner choice is made already
                return self._choice(condition, x, b)
            if a == x:
                return self._choice(self._record("or", condition, inner), x, b)
        if self._is(x, "select"):
            inner, a, b = self._operands(x)
            if inner == condition:
                return self._choice(condition, a, y)
            if b == y:
                return self._choice(self._record("and", condition, inner), a, y)
        return self._record("select", condition, x, y)
