"""LLVM IR of a trace: a loop over sub-steps in which every operation is a vector.

One value holds all lanes of a block (``<4 x double>``), so nothing is left to a vectoriser. Only
strict IEEE operations are used. The compiler may not contract or reassociate: the fused operations
are the trace's own. So a lane's result depends neither on the lanes beside it, nor on the width of the
block, nor on the machine.
"""

from __future__ import annotations

import struct

from snake_env.equations.rewriting import FUSED
from snake_env.equations.tracing import Operation, Trace

_COMPARISONS = ("olt", "ole", "ogt", "oge", "oeq")


def emit(
    loop: Trace,
    last: Trace,
    rows: int,
    running: int,
    clock_width: int,
    lanes: int,
    mask_registers: bool = True,
) -> str:
    """LLVM IR of ``run(blocks, constants, clock, n_steps, n_blocks)``.

    For each block, runs ``loop`` once per sub-step until ``n_steps`` are done or no lane is running
    any more, and then ``last`` once.

    Args:
        loop: One sub-step.
        last: What is done after the last sub-step.
        rows: Rows of a block.
        running: The row that is 0 for the lanes that are running.
        clock_width: Numbers in a row of the clock.
        lanes: Lanes in a block.
        mask_registers: Whether the machine has registers for conditions, one bit per lane. Otherwise
            a condition is as wide as a number: LLVM would pack and unpack it again and again.
    """
    vector, align = f"<{lanes} x double>", min(64, 8 * lanes)
    return "\n".join(
        (
            f"declare {vector} @llvm.sqrt.v{lanes}f64({vector})",
            f"declare {vector} @llvm.fabs.v{lanes}f64({vector})",
            f"declare {vector} @llvm.fma.v{lanes}f64({vector}, {vector}, {vector})",
            "define void @run(ptr noalias %blocks, ptr noalias %shared, ptr noalias %clock,",
            '                 i64 %n_steps, i64 %n_blocks) nounwind "stackrealign"',
            '    "prefer-vector-width"="512" "min-legal-vector-width"="512" {',
            "entry:",
            "  %moves = icmp ugt i64 %n_steps, 0",
            "  br label %block",
            "block:",
            "  %b = phi i64 [0, %entry], [%b.next, %last]",
            f"  %b.offset = mul i64 %b, {rows * lanes}",
            "  %lanes = getelementptr double, ptr %blocks, i64 %b.offset",
            "  br i1 %moves, label %loop, label %last",
            "loop:",
            "  %s = phi i64 [0, %block], [%s.next, %loop]",
            f"  %s.offset = mul i64 %s, {clock_width}",
            "  %now = getelementptr double, ptr %clock, i64 %s.offset",
            *_Code(loop, "a", lanes, mask_registers).lines(),
            f"  %running.p = getelementptr double, ptr %lanes, i64 {running * lanes}",
            f"  %running.v = load {vector}, ptr %running.p, align {align}",
            f"  %running = fcmp oeq {vector} %running.v, zeroinitializer",
            f"  %running.bits = bitcast <{lanes} x i1> %running to i{lanes}",
            f"  %any = icmp ne i{lanes} %running.bits, 0",
            "  %s.next = add i64 %s, 1",
            "  %more = icmp ult i64 %s.next, %n_steps",
            "  %again = and i1 %any, %more",
            "  br i1 %again, label %loop, label %last",
            "last:",
            *_Code(last, "z", lanes, mask_registers).lines(),
            "  %b.next = add i64 %b, 1",
            "  %left = icmp ult i64 %b.next, %n_blocks",
            "  br i1 %left, label %block, label %exit",
            "exit:",
            "  ret void",
            "}",
        )
    )


def _number(value: float) -> str:
    return "0x" + struct.pack(">d", value).hex().upper()


class _Code:
    """Instructions of a trace, each value named after its position."""

    def __init__(self, trace: Trace, prefix: str, lanes: int, mask_registers: bool) -> None:
        self._trace, self._prefix, self._lanes = trace, prefix, lanes
        self._vector, self._bits = f"<{lanes} x double>", f"<{lanes} x i1>"
        self._mask = self._bits if mask_registers else f"<{lanes} x i64>"
        self._all = f"<{', '.join([self._mask.split()[2][:-1] + ' -1'] * lanes)}>"
        self._align = min(64, 8 * lanes)  # blocks start at multiples of 64 bytes

    def lines(self) -> list[str]:
        """The loads and the arithmetic, then the stores."""
        lines = []
        for position, operation in enumerate(self._trace.operations):
            lines += self._instructions(f"%{self._prefix}{position}", operation)
        for row, position in self._trace.stores:
            pointer = f"%{self._prefix}store{row}"
            lines.append(self._address(pointer, "%lanes", row * self._lanes))
            value = f"{self._vector} {self._name(position)}"
            lines.append(f"  store {value}, ptr {pointer}, align {self._align}")
        return lines

    def _name(self, position: int | float) -> str:
        operation = self._trace.operations[int(position)]
        if operation.name == "number":
            number = _number(float(operation.operands[0]))
            return f"<{', '.join([f'double {number}'] * self._lanes)}>"
        return f"%{self._prefix}{int(position)}"

    def _address(self, result: str, base: str, offset: int) -> str:
        return f"  {result} = getelementptr double, ptr {base}, i64 {offset}"

    def _instructions(self, result: str, operation: Operation) -> list[str]:
        kind, operands = operation
        vector = self._vector
        if kind == "number":
            return []
        if kind == "lane":
            return [
                self._address(f"{result}.p", "%lanes", int(operands[0]) * self._lanes),
                f"  {result} = load {vector}, ptr {result}.p, align {self._align}",
            ]
        if kind in ("shared", "clock"):
            return self._broadcast(result, "%shared" if kind == "shared" else "%now", operands)
        values = [self._name(operand) for operand in operands]
        if kind in FUSED:
            return self._fused(result, kind, values)
        if kind in _COMPARISONS:
            return self._condition(result, f"fcmp {kind} {vector} {values[0]}, {values[1]}")
        if kind == "select":
            return self._choice(result, *values)
        return [f"  {result} = {self._plain(kind, values)}"]

    def _plain(self, kind: str, values: list[str]) -> str:
        if kind in ("fadd", "fsub", "fmul", "fdiv"):
            return f"{kind} {self._vector} {values[0]}, {values[1]}"
        if kind == "fneg":
            return f"fneg {self._vector} {values[0]}"
        if kind in ("sqrt", "fabs"):
            return self._call(kind, values)
        if kind in ("and", "or"):
            return f"{kind} {self._mask} {values[0]}, {values[1]}"
        if kind == "not":
            return f"xor {self._mask} {values[0]}, {self._all}"
        raise AssertionError(f"no instruction for {kind}")

    def _call(self, function: str, values: list[str]) -> str:
        arguments = ", ".join(f"{self._vector} {value}" for value in values)
        return f"call {self._vector} @llvm.{function}.v{self._lanes}f64({arguments})"

    def _fused(self, result: str, kind: str, values: list[str]) -> list[str]:
        a, b, c = values
        lines = []
        if kind in ("fnma", "fnms"):
            lines.append(f"  {result}.a = fneg {self._vector} {a}")
            a = f"{result}.a"
        if kind in ("fms", "fnms"):
            lines.append(f"  {result}.c = fneg {self._vector} {c}")
            c = f"{result}.c"
        return [*lines, f"  {result} = {self._call('fma', [a, b, c])}"]

    def _broadcast(self, result: str, base: str, operands: tuple[int | float, ...]) -> list[str]:
        vector, splat = self._vector, f"<{self._lanes} x i32> zeroinitializer"
        return [
            self._address(f"{result}.p", base, int(operands[0])),
            f"  {result}.s = load double, ptr {result}.p, align 8",
            f"  {result}.i = insertelement {vector} poison, double {result}.s, i64 0",
            f"  {result} = shufflevector {vector} {result}.i, {vector} poison, {splat}",
        ]

    def _condition(self, result: str, comparison: str) -> list[str]:
        if self._mask == self._bits:
            return [f"  {result} = {comparison}"]
        return [
            f"  {result}.b = {comparison}",
            f"  {result} = sext {self._bits} {result}.b to {self._mask}",
        ]

    def _choice(self, result: str, condition: str, if_true: str, if_false: str) -> list[str]:
        lines = []
        if self._mask != self._bits:
            lines.append(f"  {result}.b = icmp slt {self._mask} {condition}, zeroinitializer")
            condition = f"{result}.b"
        vector = self._vector
        choice = f"select {self._bits} {condition}, {vector} {if_true}, {vector} {if_false}"
        return [*lines, f"  {result} = {choice}"]
