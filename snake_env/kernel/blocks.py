"""Compiled programs over blocks of lanes, and the threads that share the blocks."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from snake_env.equations.control import redundancy_gain
from snake_env.equations.rewriting import rewritten
from snake_env.equations.tracing import Trace
from snake_env.errors import InvalidInputError, as_integer
from snake_env.kernel.compiler import BlockFunction, load, vector_bits
from snake_env.kernel.emission import emit
from snake_env.kernel.scheduling import scheduled
from snake_env.params import SnakeParams

_FLOATS = [f.name for f in dataclasses.fields(SnakeParams) if isinstance(f.default, float)]
_TUPLES = [
    (f.name, len(f.default))
    for f in dataclasses.fields(SnakeParams)
    if isinstance(f.default, tuple)
]


@functools.cache
def block_widths() -> tuple[int, ...]:
    """Widths of blocks that are worth a program of their own on this machine, narrowest first.

    Eight lanes where a register holds eight numbers; there, four take a block through an interval
    in two thirds of the time. Elsewhere four: with eight, each value takes two of the sixteen
    registers, and most values wait in memory; with two, a block is less than a tenth faster.
    """
    return (4, 8) if vector_bits() >= 512 else (4,)


def block_width(count: int | None = None) -> int:
    """Lanes of a block on this machine; results do not depend on it.

    Args:
        count: Lanes that are run at a time; default: many.

    Returns:
        The least width that holds them all in one block, or else the greatest.
    """
    widths = block_widths()
    return next((width for width in widths if count is not None and count <= width), widths[-1])


class BlockProgram:
    """Machine code that works on blocks of lanes in place.

    Args:
        loop: What is done once per sub-step.
        last: What is done once at the end.
        n_rows: Rows of a block.
        running: The row that is 0 for the lanes that are running.
        what: Name for the announcement of the compilation.
        lanes: Lanes of a block; default: what suits many.

    Attributes:
        loop: What is computed once per sub-step, rewritten and scheduled.
        last: What is computed once at the end, rewritten and scheduled.
    """

    def __init__(
        self, loop: Trace, last: Trace, n_rows: int, running: int, what: str, lanes: int | None
    ) -> None:
        self.n_rows, self.lanes = n_rows, lanes or block_width()
        self.loop, self.last = (scheduled(rewritten(trace)) for trace in (loop, last))
        ir = emit(self.loop, self.last, n_rows, running, 2, self.lanes, vector_bits() >= 512)
        self._run: BlockFunction = load(ir, what)

    def blocks(self, count: int) -> NDArray[np.float64]:
        """An uninitialised lane buffer for ``count`` lanes: (n_blocks, n_rows, lanes), aligned."""
        shape = (-(-count // self.lanes), self.n_rows, self.lanes)
        size = math.prod(shape)
        raw = np.empty(size + 7)
        offset = -(raw.ctypes.data // 8) % 8
        return raw[offset : offset + size].reshape(shape)

    def run(
        self,
        blocks: NDArray[np.float64],
        constants: NDArray[np.float64],
        clock: NDArray[np.float64],
    ) -> None:
        """Works on all blocks: one sub-step for each row of the clock, then what comes last.

        Args:
            blocks: Lane buffer from :meth:`blocks`, filled.
            constants: From :func:`constants_of`.
            clock: From :func:`clock_of`, or consecutive rows of it.
        """

        def part(first: int, count: int) -> None:
            address = blocks.ctypes.data + 8 * first * self.n_rows * self.lanes
            self._run(address, constants.ctypes.data, clock.ctypes.data, len(clock), count)

        n_blocks = len(blocks)
        n_threads, pool = _threads.now()
        n_threads = min(n_threads, n_blocks)
        if n_threads == 0:
            return
        if n_threads == 1 or pool is None:
            part(0, n_blocks)
            return
        edges = [n_blocks * k // n_threads for k in range(n_threads + 1)]
        tasks = [(first, stop - first) for first, stop in itertools.pairwise(edges)]
        list(pool.map(part, *zip(*tasks, strict=True)))

    def bind(
        self, blocks: NDArray[np.float64], constants: NDArray[np.float64]
    ) -> Callable[[], None]:
        """What comes last, on these blocks, in one thread: for calls so short that addresses count.

        Args:
            blocks: As in :meth:`run`; must live as long as what is returned.
            constants: As in :meth:`run`; must live as long as what is returned.
        """
        addresses = blocks.ctypes.data, constants.ctypes.data, 0
        return functools.partial(self._run, *addresses, 0, len(blocks))


class _Threads:
    """How many threads share the blocks of a call, and the pool that they live in."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 1
        self._pool: ThreadPoolExecutor | None = None

    def now(self) -> tuple[int, ThreadPoolExecutor | None]:
        """The number of threads and their pool; a caller may use it even if it is replaced."""
        with self._lock:
            if self._pool is None and self._count > 1:
                self._pool = ThreadPoolExecutor(self._count, thread_name_prefix="snake_env")
            return self._count, self._pool

    def resize(self, count: int) -> None:
        """Replaces the pool; the old one's threads end once nobody uses it any more."""
        with self._lock:
            self._count, self._pool = count, None

    def forget(self) -> None:
        """Drops pool and lock: a forked process has none of the pool's threads."""
        self._lock = threading.Lock()
        self._pool = None


_threads = _Threads()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.forget)


def set_num_threads(count: int) -> None:
    """Sets how many threads one call of the kernel uses, at first 1. Results stay the same.

    Args:
        count: Threads, at least 1.

    Raises:
        InvalidInputError: ``count`` is not a positive integer.
    """
    number = as_integer(count)
    if number is None or number < 1:
        raise InvalidInputError("count", count, "a positive number of threads")
    _threads.resize(number)


def traced_params(trace: Trace, head_contact: bool) -> SnakeParams:
    """Constants whose numbers are loads from the program's arguments."""
    row = itertools.count()
    p = SimpleNamespace(head_contact=head_contact)
    for name in _FLOATS:
        setattr(p, name, trace.shared(next(row)))
    for name, length in _TUPLES:
        setattr(p, name, tuple(trace.shared(next(row)) for _ in range(length)))
    return cast(SnakeParams, p)


@functools.lru_cache(maxsize=256)
def constants_of(params: SnakeParams) -> NDArray[np.float64]:
    """The constants in the order in which the kernel reads them, read-only."""
    values = [getattr(params, name) for name in _FLOATS]
    for name, _ in _TUPLES:
        values += getattr(params, name)
    constants = np.array(values, dtype=np.float64)
    constants.setflags(write=False)
    return constants


@functools.lru_cache(maxsize=256)
def clock_of(params: SnakeParams) -> NDArray[np.float64]:
    """Time inside the interval and k_eta (16) for each sub-step, shape (n_steps, 2), read-only."""
    times = [step * params.dt for step in range(params.n_steps)]
    clock = np.array([(t, redundancy_gain(t, params)) for t in times], dtype=np.float64)
    clock.setflags(write=False)
    return clock
