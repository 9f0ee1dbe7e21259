"""Records what a function does to generic scalars, as straight-line code for the compiler.

A :class:`Trace` is a list of operations in which each distinct one stands once (common
subexpressions are shared). A :class:`Traced` value stands for the result of one of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

LEAVES = ("lane", "shared", "clock", "number")
"""Operations without operands in the trace: loads, and numbers."""


class Operation(NamedTuple):
    """One operation: its name, and its operands as positions in the trace, numbers or rows."""

    name: str
    operands: tuple[int | float, ...]


class Trace:
    """Straight-line code over one lane: loads, arithmetic and stores, in order.

    Attributes:
        operations: The distinct operations; an operand is the position of an earlier one.
        stores: Pairs ``(row, position)``: where results go once everything has been computed.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self.stores: list[tuple[int, int]] = []
        self._positions: dict[Operation, int] = {}

    def record(self, name: str, *operands: int | float) -> int:
        """Position of the operation, which is added unless the trace holds it already."""
        key = operation = Operation(name, operands)
        if name in ("fadd", "fmul") and operands[0] > operands[1]:
            key = Operation(name, operands[::-1])  # commutes exactly
        if key not in self._positions:
            self._positions[key] = len(self.operations)
            self.operations.append(operation)
        return self._positions[key]

    def lane(self, row: int) -> Traced:
        """The value in a row of the lane buffer: one number per lane."""
        return Traced(self, self.record("lane", row))

    def shared(self, row: int) -> Traced:
        """The value in a row of the constants: the same for all lanes."""
        return Traced(self, self.record("shared", row))

    def clock(self, row: int) -> Traced:
        """The value in a column of the clock's row of the current sub-step."""
        return Traced(self, self.record("clock", row))

    def store(self, row: int, value: float | Traced) -> None:
        """Writes a value to a row of the lane buffer once everything has been computed."""
        self.stores.append((row, self.position(value)))

    def position(self, value: float | Traced) -> int:
        """Position of a traced value, or of a number's constant."""
        return value.position if isinstance(value, Traced) else self.record("number", float(value))

    def in_order(self, order: Iterable[int]) -> Trace:
        """A trace that stores the same results, of the operations at these positions.

        Args:
            order: Positions; computed operands come before what needs them. Loads and numbers may be
                left out: each stands just before its first use.
        """
        ordered = Trace()
        places: dict[int, int] = {}

        def place(position: int) -> int:
            if position not in places:
                name, operands = self.operations[position]
                moved = operands if name in LEAVES else [place(int(each)) for each in operands]
                places[position] = ordered.record(name, *moved)
            return places[position]

        for position in order:
            if self.operations[position].name not in LEAVES:
                place(position)
        ordered.stores = [(row, place(position)) for row, position in self.stores]
        return ordered


class Traced:
    """A floating-point value that a trace computes."""

    __slots__ = ("position", "trace")

    def __init__(self, trace: Trace, position: int) -> None:
        self.trace = trace
        self.position = position

    def _binary(self, name: str, left: float | Traced, right: float | Traced) -> Traced:
        trace = self.trace
        return Traced(trace, trace.record(name, trace.position(left), trace.position(right)))

    def _compare(self, name: str, other: float | Traced) -> TracedBool:
        trace = self.trace
        return TracedBool(trace, trace.record(name, self.position, trace.position(other)))

    def __add__(self, other: float | Traced) -> Traced:
        return self._binary("fadd", self, other)

    def __radd__(self, other: float) -> Traced:
        return self._binary("fadd", other, self)

    def __sub__(self, other: float | Traced) -> Traced:
        return self._binary("fsub", self, other)

    def __rsub__(self, other: float) -> Traced:
        return self._binary("fsub", other, self)

    def __mul__(self, other: float | Traced) -> Traced:
        return self._binary("fmul", self, other)

    def __rmul__(self, other: float) -> Traced:
        return self._binary("fmul", other, self)

    def __truediv__(self, other: float | Traced) -> Traced:
        return self._binary("fdiv", self, other)

    def __rtruediv__(self, other: float) -> Traced:
        return self._binary("fdiv", other, self)

    def __neg__(self) -> Traced:
        return Traced(self.trace, self.trace.record("fneg", self.position))

    def absolute(self) -> Traced:
        """Absolute value."""
        return Traced(self.trace, self.trace.record("fabs", self.position))

    def sqrt(self) -> Traced:
        """Square root."""
        return Traced(self.trace, self.trace.record("sqrt", self.position))

    def __lt__(self, other: float | Traced) -> TracedBool:
        return self._compare("olt", other)

    def __le__(self, other: float | Traced) -> TracedBool:
        return self._compare("ole", other)

    def __gt__(self, other: float | Traced) -> TracedBool:
        return self._compare("ogt", other)

    def __ge__(self, other: float | Traced) -> TracedBool:
        return self._compare("oge", other)

    def __eq__(self, other: object) -> TracedBool:  # type: ignore[override]
        if not isinstance(other, (float, int, Traced)):
            return NotImplemented
        return self._compare("oeq", other)

    __hash__ = None  # type: ignore[assignment]


class TracedBool:
    """A condition that a trace computes."""

    __slots__ = ("position", "trace")

    def __init__(self, trace: Trace, position: int) -> None:
        self.trace = trace
        self.position = position

    def __and__(self, other: TracedBool) -> TracedBool:
        return TracedBool(self.trace, self.trace.record("and", self.position, other.position))

    def __or__(self, other: TracedBool) -> TracedBool:
        return TracedBool(self.trace, self.trace.record("or", self.position, other.position))

    def __invert__(self) -> TracedBool:
        return TracedBool(self.trace, self.trace.record("not", self.position))

    def select(self, if_true: float | Traced, if_false: float | Traced) -> Traced:
        """``if_true`` where this holds, else ``if_false``."""
        trace = self.trace
        operands = (self.position, trace.position(if_true), trace.position(if_false))
        return Traced(trace, trace.record("select", *operands))

    def __bool__(self) -> bool:
        raise TypeError("a traced condition has no truth value: use scalars.select")
