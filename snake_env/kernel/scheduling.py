"""The order of a trace's operations: what overlaps in time without filling the registers.

A processor looks some hundred instructions ahead. In code that finishes one result after the other it
finds chains of dependent operations there, and most of its units wait. The order here changes no
result: every operation keeps its operands. It makes the kernel about a fifth faster.
"""

from __future__ import annotations

import heapq

from snake_env.equations.tracing import LEAVES, Trace

_LATENCIES = {"fdiv": 14, "sqrt": 18, "fabs": 1, "fneg": 1, "and": 1, "or": 1, "not": 1}
_LATENCY = 4  # of all others; in cycles, typical of today's processors


def scheduled(trace: Trace) -> Trace:
    """The same operations in another order; loads and numbers stand just before their first use.

    A list scheduler (Cooper and Torczon, Engineering a Compiler, section 12.3): of the operations
    whose operands are known it takes the one that is the last user of most of them, which frees
    registers; among those, the one with the longest way to a result.
    """
    operations = trace.operations
    operands = [_computed_operands(trace, position) for position in range(len(operations))]
    users: list[list[int]] = [[] for _ in operations]
    for position, needed in enumerate(operands):
        for operand in needed:
            users[operand].append(position)
    length = _longest_ways(trace, users)
    missing = [len(needed) for needed in operands]
    waiting = [len(each) for each in users]  # users that are still to come
    for _, position in trace.stores:
        waiting[position] += 1  # results stay until the end
    frees = [sum(waiting[operand] == 1 for operand in needed) for needed in operands]
    taken = [operation.name in LEAVES for operation in operations]
    ready: list[tuple[int, int, int]] = []

    def offer(position: int) -> None:
        heapq.heappush(ready, (-frees[position], -length[position], position))

    for position, count in enumerate(missing):
        if count == 0 and not taken[position]:
            offer(position)
    order = []
    while ready:
        position = heapq.heappop(ready)[2]
        if taken[position]:
            continue  # it was offered again when it came to free more
        taken[position] = True
        order.append(position)
        for user in users[position]:
            missing[user] -= 1
            if missing[user] == 0:
                offer(user)
        for operand in operands[position]:
            waiting[operand] -= 1
            if waiting[operand] == 1:
                for last in users[operand]:
                    if not taken[last]:
                        frees[last] += 1
                        if missing[last] == 0:
                            offer(last)
    return trace.in_order(order)


def _computed_operands(trace: Trace, position: int) -> set[int]:
    """Positions of the operands that are neither loads nor numbers."""
    name, operands = trace.operations[position]
    if name in LEAVES:
        return set()
    return {int(each) for each in operands if trace.operations[int(each)].name not in LEAVES}


def _longest_ways(trace: Trace, users: list[list[int]]) -> list[int]:
    """Cycles from the start of each operation to the last result that depends on it."""
    length = [0] * len(users)
    for position in reversed(range(len(users))):
        latency = _LATENCIES.get(trace.operations[position].name, _LATENCY)
        length[position] = latency + max((length[user] for user in users[position]), default=0)
    return length
