"""Multi-layer perceptrons for a few inputs at a time: a decision asks about one to eight states.

BLAS is made for large matrices; it copies all weights into another order at every call. Here they are
put into that order once: panels of as many columns as two registers hold, row after row. All inputs of
a group go through a panel together, and each result is summed up in the order of the inputs.
"""

from __future__ import annotations

import functools
import itertools
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from snake_env.kernel.compiler import BlockFunction, load, vector_bits

GROUP = 4
"""Inputs that go through the layers together: as many as are free beside the time that one addition
waits for the last."""
_FIELDS = 6  # what the program reads of a layer
_WEIGHTS, _BIASES, _INPUTS, _PANELS, _LEAST, _STRIDE = range(_FIELDS)


_Pair = tuple[NDArray[np.float32], NDArray[np.float32], tuple[int, int, int]]
"""Inputs, outputs, and the addresses of what the program takes."""


class Perceptron:
    """Linear layers with rectifiers between them, compiled.

    Args:
        weights: One matrix for each layer, shape (inputs, outputs).
        biases: One vector for each layer, shape (outputs,).
    """

    def __init__(
        self, weights: Sequence[NDArray[np.float32]], biases: Sequence[NDArray[np.float32]]
    ) -> None:
        panel = 2 * _width()
        self._inputs, self._outputs = weights[0].shape[0], weights[-1].shape[1]
        self._panels = [_panels(weight, panel) for weight in weights]
        self._biases = [_panels(bias[None], panel) for bias in biases]
        self._stride = max(-(-size // panel) * panel for weight in weights for size in weight.shape)
        layers = np.zeros((len(weights), _FIELDS), np.int64)
        for row, packed, bias in zip(layers, self._panels, self._biases, strict=True):
            row[_WEIGHTS], row[_BIASES] = packed.ctypes.data, bias.ctypes.data
            row[_PANELS], row[_INPUTS] = packed.shape[:2]
        least = np.zeros(len(weights), np.float32)
        least[-1] = -np.inf
        layers[:, _LEAST], layers[:, _STRIDE] = least.view(np.uint32), self._stride
        self._layers = layers
        self._run = _program()
        self._buffers = _Buffers()

    def __call__(self, x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Outputs, shape (N, outputs), for inputs of shape (N, inputs).

        Raises:
            ValueError: The inputs are of another size.
        """
        count, size = x.shape
        if size != self._inputs:
            raise ValueError(f"inputs of {self._inputs} values, not {size}")
        if count == 0:
            return np.empty((0, self._outputs), np.float32)
        groups = -(-count // GROUP)
        if groups not in self._buffers.of:
            self._buffers.of[groups] = self._pair(groups)
        inputs, outputs, addresses = self._buffers.of[groups]
        inputs[:count, :size] = x
        self._run(*addresses, len(self._layers), groups)
        return outputs[:count, : self._outputs].copy()

    def _pair(self, groups: int) -> _Pair:
        """Where layers read and write in turns."""
        pair = np.zeros((2, groups * GROUP, self._stride), np.float32)
        addresses = (pair[0].ctypes.data, self._layers.ctypes.data, pair[1].ctypes.data)
        return pair[0], pair[len(self._layers) % 2], addresses


class _Buffers(threading.local):
    """A thread's own, by the number of groups."""

    def __init__(self) -> None:
        self.of: dict[int, _Pair] = {}


def _width() -> int:
    """Numbers in a register."""
    return vector_bits() // 32


def _panels(matrix: NDArray[np.float32], panel: int) -> NDArray[np.float32]:
    """Columns in panels, shape (panels, rows, panel), filled up with zeros."""
    rows, columns = matrix.shape
    count = -(-columns // panel)
    padded = np.zeros((rows, count * panel), np.float32)
    padded[:, :columns] = matrix
    return np.ascontiguousarray(padded.reshape(rows, count, panel).transpose(1, 0, 2))


@functools.cache
def _program() -> BlockFunction:
    """The program, which all networks share: it reads their sizes from the layers."""
    return load(_ir(_width()), "networks")


def _ir(width: int) -> str:
    """LLVM IR of ``run(inputs, layers, others, n_layers, n_groups)``.

    Args:
        width: Numbers in a register.
    """
    vector, panel, rows, halves = f"<{width} x float>", 2 * width, range(GROUP), range(2)
    sums = list(itertools.product(rows, halves))
    return "\n".join(
        (
            f"declare {vector} @llvm.fma.v{width}f32({vector}, {vector}, {vector})",
            "define void @run(ptr noalias %x, ptr noalias %layers, ptr noalias %y,",
            '                 i64 %n_layers, i64 %n_groups) nounwind "stackrealign"',
            '    "prefer-vector-width"="512" "min-legal-vector-width"="512" {',
            "entry:",
            f"  %stride.p = getelementptr i64, ptr %layers, i64 {_STRIDE}",
            "  %stride = load i64, ptr %stride.p",
            f"  %group.size = mul i64 %stride, {GROUP}",
            "  br label %group",
            "group:",
            "  %g = phi i64 [0, %entry], [%g.next, %group.end]",
            "  %g.offset = mul i64 %g, %group.size",
            "  %x.group = getelementptr float, ptr %x, i64 %g.offset",
            "  %y.group = getelementptr float, ptr %y, i64 %g.offset",
            "  br label %layer",
            "layer:",
            "  %k = phi i64 [0, %group], [%k.next, %layer.end]",
            "  %from = phi ptr [%x.group, %group], [%to, %layer.end]",
            "  %to = phi ptr [%y.group, %group], [%from, %layer.end]",
            f"  %k.offset = mul i64 %k, {_FIELDS}",
            "  %fields = getelementptr i64, ptr %layers, i64 %k.offset",
            *_loaded("weights", _WEIGHTS),
            *_loaded("biases", _BIASES),
            *_loaded("inputs", _INPUTS),
            *_loaded("panels", _PANELS),
            *_loaded("least", _LEAST),
            "  %w.first = inttoptr i64 %weights to ptr",
            "  %b.first = inttoptr i64 %biases to ptr",
            "  %least.bits = trunc i64 %least to i32",
            "  %least.f = bitcast i32 %least.bits to float",
            *_everywhere("floor", "%least.f", width),
            *(f"  %row{r}.offset = mul i64 %stride, {r}" for r in rows),
            *(f"  %from{r} = getelementptr float, ptr %from, i64 %row{r}.offset" for r in rows),
            *(f"  %to{r} = getelementptr float, ptr %to, i64 %row{r}.offset" for r in rows),
            "  br label %panel",
            "panel:",
            "  %p = phi i64 [0, %layer], [%p.next, %panel.end]",
            "  %w.panel = phi ptr [%w.first, %layer], [%w.next, %panel.end]",
            f"  %column0 = mul i64 %p, {panel}",
            f"  %column1 = add i64 %column0, {width}",
            *(f"  %b{h}.p = getelementptr float, ptr %b.first, i64 %column{h}" for h in halves),
            *(f"  %b{h} = load {vector}, ptr %b{h}.p, align 4" for h in halves),
            "  br label %input",
            "input:",
            "  %i = phi i64 [0, %panel], [%i.next, %input]",
            "  %w0.p = phi ptr [%w.panel, %panel], [%w.next, %input]",
            *(
                f"  %old{r}{h} = phi {vector} [%b{h}, %panel], [%sum{r}{h}, %input]"
                for r, h in sums
            ),
            f"  %w1.p = getelementptr float, ptr %w0.p, i64 {width}",
            *(f"  %w{h} = load {vector}, ptr %w{h}.p, align 4" for h in halves),
            *(f"  %in{r}.p = getelementptr float, ptr %from{r}, i64 %i" for r in rows),
            *(f"  %in{r}.f = load float, ptr %in{r}.p" for r in rows),
            *(line for r in rows for line in _everywhere(f"in{r}", f"%in{r}.f", width)),
            *(
                f"  %sum{r}{h} = call {vector} @llvm.fma.v{width}f32"
                f"({vector} %in{r}, {vector} %w{h}, {vector} %old{r}{h})"
                for r, h in sums
            ),
            f"  %w.next = getelementptr float, ptr %w0.p, i64 {panel}",
            *_next("i", "inputs", "input", "panel.end"),
            "panel.end:",
            *(f"  %low{r}{h} = fcmp olt {vector} %sum{r}{h}, %floor" for r, h in sums),
            *(
                f"  %out{r}{h} = select <{width} x i1> %low{r}{h}, "
                f"{vector} %floor, {vector} %sum{r}{h}"
                for r, h in sums
            ),
            *(f"  %out{r}{h}.p = getelementptr float, ptr %to{r}, i64 %column{h}" for r, h in sums),
            *(f"  store {vector} %out{r}{h}, ptr %out{r}{h}.p, align 4" for r, h in sums),
            *_next("p", "panels", "panel", "layer.end"),
            "layer.end:",
            *_next("k", "n_layers", "layer", "group.end"),
            "group.end:",
            *_next("g", "n_groups", "group", "exit"),
            "exit:",
            "  ret void",
            "}",
        )
    )


def _loaded(name: str, number: int) -> list[str]:
    """Loads a field of the layer."""
    return [
        f"  %{name}.p = getelementptr i64, ptr %fields, i64 {number}",
        f"  %{name} = load i64, ptr %{name}.p",
    ]


def _everywhere(name: str, number: str, width: int) -> list[str]:
    """A vector of a number."""
    vector = f"<{width} x float>"
    return [
        f"  %{name}.one = insertelement {vector} poison, float {number}, i64 0",
        f"  %{name} = shufflevector {vector} %{name}.one, {vector} poison, "
        f"<{width} x i32> zeroinitializer",
    ]


def _next(counter: str, count: str, again: str, then: str) -> list[str]:
    """The end of a loop."""
    return [
        f"  %{counter}.next = add i64 %{counter}, 1",
        f"  %{counter}.more = icmp ult i64 %{counter}.next, %{count}",
        f"  br i1 %{counter}.more, label %{again}, label %{then}",
    ]
