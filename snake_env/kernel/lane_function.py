"""Compiled functions of one state each: some numbers in, some numbers out, no sub-steps.

The masks and the observation are such functions. Many states go through in blocks of lanes; a
single one is spared the copies and allocations that only many are worth.
"""

from __future__ import annotations

import functools
import itertools
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from snake_env.equations.scalars import Scalar
from snake_env.equations.tracing import Trace
from snake_env.kernel.blocks import BlockProgram, clock_of, constants_of, traced_params
from snake_env.params import SnakeParams


class LaneFunction(BlockProgram):
    """A function of generic scalars, compiled: its arguments fill a block's first rows.

    Args:
        function: Gets the constants and its arguments: a list of scalars each or, where the length
            is 1, a scalar.
        lengths: How many scalars there are in each argument.
        head_contact: That of the constants.
        what: Name for the announcement of the compilation.
        lanes: Lanes of a block; default: what suits many.

    Attributes:
        rows: Rows of a block that hold each argument.
        n_arguments: How many they are; the results follow them.
    """

    def __init__(
        self,
        function: Callable[..., list[Scalar]],
        lengths: Sequence[int],
        head_contact: bool,
        what: str,
        lanes: int | None = None,
    ) -> None:
        trace = Trace()
        edges = [0, *itertools.accumulate(lengths)]
        self.n_arguments = edges[-1]
        self.rows = [slice(*pair) for pair in itertools.pairwise(edges)]
        loads = [trace.lane(row) for row in range(self.n_arguments)]
        arguments = [
            loads[rows] if length > 1 else loads[rows.start]
            for rows, length in zip(self.rows, lengths, strict=True)
        ]
        results = function(traced_params(trace, head_contact), *arguments)
        for row, result in enumerate(results, start=self.n_arguments):
            trace.store(row, result)
        super().__init__(Trace(), trace, self.n_arguments + len(results), 0, what, lanes)

    def of_many(
        self, params: SnakeParams, arguments: Sequence[NDArray[Any]], dtype: DTypeLike
    ) -> NDArray[Any]:
        """Results for N lanes.

        Args:
            params: The constants.
            arguments: Shapes (N, length) or, where the length is 1, (N,).
            dtype: Type of the results.

        Returns:
            Shape (N, n_results), freshly allocated.
        """
        count = len(arguments[0])
        blocks = self.blocks(count)
        lanes = np.zeros((self.n_arguments, len(blocks) * self.lanes))
        for rows, argument in zip(self.rows, arguments, strict=True):
            lanes[rows, :count] = argument.T
        by_block = lanes.reshape(self.n_arguments, len(blocks), self.lanes)
        blocks[:, : self.n_arguments] = by_block.transpose(1, 0, 2)
        self.run(blocks, constants_of(params), clock_of(params)[:0])
        return self.results(blocks, dtype)[:count]

    def results(self, blocks: NDArray[np.float64], dtype: DTypeLike) -> NDArray[Any]:
        """The results in blocks that have been run: a row for each lane, padding included."""
        results = np.empty((len(blocks), self.lanes, self.n_rows - self.n_arguments), dtype)
        results[:] = blocks[:, self.n_arguments :].transpose(0, 2, 1)
        return results.reshape(-1, results.shape[2])

    def of_one(
        self, params: SnakeParams, arguments: Sequence[ArrayLike], dtype: DTypeLike
    ) -> NDArray[Any]:
        """The result for one lane, bit for bit that of :meth:`of_many`.

        Args:
            params: The constants.
            arguments: Shapes (length,) or, where the length is 1, numbers.
            dtype: Type of the result.

        Returns:
            Shape (n_results,), freshly allocated.
        """
        lane = _lane(self, params, threading.get_ident())
        for rows, argument in zip(self.rows, arguments, strict=True):
            lane.arguments[rows] = argument
        lane.compute()
        return lane.results.astype(dtype)


class _Lane:
    """The first lane of a block, and the program bound to it."""

    def __init__(self, function: LaneFunction, params: SnakeParams) -> None:
        self._block, self._constants = function.blocks(1), constants_of(params)
        self._block[:] = 0.0
        self.arguments = self._block[0, : function.n_arguments, 0]
        self.results = self._block[0, function.n_arguments :, 0]
        self.compute = function.bind(self._block, self._constants)


@functools.lru_cache(maxsize=64)
def _lane(function: LaneFunction, params: SnakeParams, thread: int) -> _Lane:
    """The lane that a thread uses again and again: no other thread may write to it."""
    return _Lane(function, params)
