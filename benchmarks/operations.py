"""What the kernel's loop consists of, and how long it would take if nothing ever waited."""

from __future__ import annotations

import ctypes
import platform
import time
from collections import Counter
from pathlib import Path

from snake_env.equations.tracing import LEAVES, Trace
from snake_env.kernel.compiler import load, vector_bits
from snake_env.kernel.interval import Kernel

_CHAIN = 4  # dependent integer operations in a turn of the loop below: one cycle each
_TURNS = 2_000_000
_CLOCK = """
define void @run(ptr %blocks, ptr %shared, ptr %clock, i64 %turns, i64 %n_blocks) {
entry:
  br label %loop
loop:
  %i = phi i64 [0, %entry], [%next, %loop]
  %x = phi i64 [1, %entry], [%x4, %loop]
  %x1 = add i64 %x, %i
  %x2 = xor i64 %x1, %n_blocks
  %x3 = add i64 %x2, %i
  %x4 = xor i64 %x3, %turns
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, %turns
  br i1 %more, label %loop, label %exit
exit:
  store i64 %x4, ptr %blocks
  ret void
}
"""


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def clock_hz() -> float:
    """Cycles per second now, by a chain of dependent integer operations."""
    run, fastest = load(_CLOCK, "measuring the clock"), float("inf")
    result = ctypes.c_int64()
    for _ in range(10):
        began = time.perf_counter()
        run(ctypes.addressof(result), 0, 0, _TURNS, 1)
        fastest = min(fastest, time.perf_counter() - began)
    return _CHAIN * _TURNS / fastest


def operations(trace: Trace) -> Counter[str]:
    """Operations of a sub-step by kind, without those that are the same in every sub-step."""
    written = {row for row, _ in trace.stores}
    constant: list[bool] = []
    counts: Counter[str] = Counter()
    for name, operands in trace.operations:
        if name in LEAVES:
            constant.append(name != "clock" and not (name == "lane" and operands[0] in written))
        else:
            constant.append(all(constant[int(operand)] for operand in operands))
            counts[_KINDS.get(name, "conditions, signs")] += not constant[-1]
    return counts


_KINDS = {
    **dict.fromkeys(("fma", "fnma", "fms", "fnms"), "fused multiply-adds"),
    **dict.fromkeys(("fadd", "fsub"), "sums"),
    **dict.fromkeys(("olt", "ole", "ogt", "oge", "oeq"), "comparisons"),
    "fmul": "products",
    "fdiv": "divisions",
    "sqrt": "roots",
    "select": "choices",
}


def composition(kernel: Kernel, measured_ns: float) -> tuple[list[str], list[list[str]]]:
    """The kernel on this machine.

    Args:
        kernel: The kernel that was measured.
        measured_ns: What it takes for a mode-sub-step [ns].
    """
    counts, bits = operations(kernel.loop), vector_bits()
    issued = 2 if bits == 512 else 4  # vector operations a cycle, on current processors
    registers = max(1, 64 * kernel.lanes // bits)  # that a value takes
    clock = clock_hz()
    least_ns = 1e9 * sum(counts.values()) * registers / issued / kernel.lanes / clock
    rows = [
        ["processor", processor()],
        ["clock [GHz]", f"{1e-9 * clock:.2f}"],
        ["vector width [bits]", str(bits)],
        ["lanes of a block", str(kernel.lanes)],
        *([kind, str(count)] for kind, count in counts.most_common()),
        ["all operations of a sub-step", str(sum(counts.values()))],
        [f"ns per mode-sub-step at {issued} operations a cycle", f"{least_ns:.0f}"],
        ["measured [ns]", f"{measured_ns:.0f}"],
        ["ratio", f"{measured_ns / least_ns:.2f}"],
    ]
    return ["", "kernel"], rows
